"""What arming is refused for beside the causes: directions that differ, what cannot be kept."""

import contextlib
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.oracle import wire
from tests.oracle.bench import GRACE_S, Bench

RELEASED_S, NEXT_TRY_S = 0.3, 1.3  # the restart state is tried again each second


def refused_to_arm(bench: Bench) -> str:
    """The reason, or nothing where it was granted and is taken back."""
    if refused := bench.client.refusal("arm"):
        return refused.message
    bench.rules.armed()
    bench.client.call("disarm")
    return ""


# --- directions ----------------------------------------------------------------------------------


def begun_apart(bench: Bench, sections: dict) -> None:
    """A gateway whose controllers echo different directions, and whose motors turn."""
    bench.speeds(1000)
    bench.vehicle.echo("PCU1", reverse=0)
    bench.vehicle.echo("PCU2", reverse=1)
    began = time.monotonic()
    bench.begin(sections)
    bench.rules.independent = True
    bench.wait(lambda: len(bench.commands(began)) >= 4, "commands")
    bench.connect()
    bench.standby()
    bench.rest(RELEASED_S)


def directions(bench: Bench) -> list[int]:
    return [f.command.reverse for f in bench.last_pair()]


def test_controllers_that_echo_different_directions_keep_theirs_and_nobody_arms(own_bench):
    bench = own_bench
    began = time.monotonic()
    begun_apart(bench, {})
    sent = {(f.can_id, f.command.reverse) for f in bench.commands(began)}
    assert sent == {(wire.PCU1_COMMAND, 0), (wire.PCU2_COMMAND, 1)}
    assert "direction" in refused_to_arm(bench)
    bench.speeds(0)
    bench.wait(lambda: directions(bench) == [0, 0], "one direction", 2.0)
    bench.rest(0.1)
    assert refused_to_arm(bench) == ""


def test_with_independent_directions_two_are_no_reason(own_bench):
    bench = own_bench
    begun_apart(bench, {"demand": {"independent_directions": True}})
    apart = {"PCU1": {"motor_reverse": False}, "PCU2": {"motor_reverse": True}}
    bench.demand(controllers=apart)
    bench.rest(RELEASED_S)
    assert directions(bench) == [0, 1]
    assert refused_to_arm(bench) == ""
    bench.speeds(0)
    bench.demand()
    bench.wait(lambda: directions(bench) == [0, 0], "one direction for the next test", 2.0)


# --- the restart state ---------------------------------------------------------------------------


def mount(*arguments: str) -> None:
    subprocess.run(["mount", *arguments], check=True)


@contextlib.contextmanager
def own_disk(bench: Bench) -> Iterator[Path]:
    """The runtime directory as a file system of its own, below a gateway in STANDBY."""
    folder = bench.folder / f"g{bench.started + 1}" / "runtime"
    folder.mkdir(parents=True)
    mount("-t", "tmpfs", "-o", "size=64k", "none", str(folder))
    try:
        bench.begin({})
        bench.connect()
        bench.standby()
        bench.rest(RELEASED_S)
        yield folder
    finally:
        bench.end()
        subprocess.run(["umount", "-l", str(folder)], check=True)


@contextlib.contextmanager
def read_only(disk: Path) -> Iterator[None]:
    mount("-o", "remount,ro", str(disk))
    try:
        yield
    finally:
        mount("-o", "remount,rw", str(disk))


@contextlib.contextmanager
def full(disk: Path) -> Iterator[None]:
    filler = disk / "filler"
    with filler.open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(bytes(4096))
    try:
        yield
    finally:
        filler.unlink()


@pytest.mark.parametrize("failing", [read_only, full])
def test_arm_is_refused_while_the_restart_state_cannot_be_kept(own_bench, failing):
    bench = own_bench
    with own_disk(bench) as disk:
        assert refused_to_arm(bench) == ""
        with failing(disk):
            bench.rest(NEXT_TRY_S)
            assert "restart state" in refused_to_arm(bench)
        bench.rest(NEXT_TRY_S)
        assert refused_to_arm(bench) == ""


def test_in_active_it_is_an_alarm_and_the_drive_goes_on(own_bench):
    bench = own_bench
    with own_disk(bench) as disk:
        bench.drive(throttle_pct=0)
        with read_only(disk):
            bench.demand(motor_reverse=True)
            bench.wait(lambda: bench.command().reverse, "reverse", 1.0)
            alarms = bench.wait(lambda: bench.why()["alarms"], "an alarm", 1.0)
            assert bench.mode() == "active"
            assert any("restart" in one["subject"] for one in alarms), alarms


def test_a_stop_is_on_the_bus_though_it_cannot_be_kept(own_bench):
    bench = own_bench
    with own_disk(bench) as disk:
        bench.drive(throttle_pct=20)
        with read_only(disk):
            bench.client.call("estop")
            bench.must_be_safe_after(time.monotonic() - GRACE_S, wire.POWER_CUT)
