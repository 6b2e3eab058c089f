"""Beginning, ending, and what survives the process: gateways of the tests' own."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from datetime import datetime
from pathlib import Path

import pytest

from tests.oracle import wire
from tests.oracle.bench import GRACE_S, Bench
from tests.oracle.process import configuration

BATTERY = "BMS_Status"


def opened(bench: Bench) -> float:
    """When the process opened the interface, by its own log."""

    def told() -> float | None:
        for line in bench.gateway.log.read_text().splitlines():
            if line.startswith("{") and (entry := json.loads(line))["event"] == "link_open":
                at = datetime.fromisoformat(entry["timestamp"]).timestamp()
                return at - bench.recorder.offset
        return None

    return bench.wait(told, "link_open")


def first_frames(bench: Bench, since: float) -> list:
    def there() -> bool:
        bench.gateway.must_run()
        return len(bench.commands(since)) >= 4

    bench.wait(there, "commands")
    return bench.commands(since)[:4]


def again(bench: Bench) -> float:
    """The next process with the same file and runtime directory."""
    since = time.monotonic()
    bench.hang_up()
    bench.launch()
    return since


def test_it_listens_for_a_second_and_while_it_hears_another_sender(own_bench):
    bench = own_bench
    bench.vehicle.silence(BATTERY)
    bench.begin({})
    began = opened(bench)
    for number in range(15):
        intruder = wire.packed(0x0008A7D0, wire.intruding())
        bench.vehicle.script((0.1 * number, None, intruder))
    first = first_frames(bench, began)
    last = bench.recorder.intruders(began)[-1].t
    assert last > began + 1.2
    assert first[0].t > last
    bench.wait(lambda: len(bench.commands(began)) > 20, "commands")
    assert {f.data for f in bench.commands(began)} == {wire.ZERO_TORQUE}


def test_it_qualifies_with_three_good_frames_and_ends_in_order(own_bench):
    bench = own_bench
    bench.vehicle.silence(BATTERY)
    bench.begin({})
    began = opened(bench)
    first = first_frames(bench, began)[0].t
    assert 0.995 <= first - began <= 1.2, f"first frame after {first - began:.3f} s"
    bench.connect()
    for number in range(3):
        assert bench.mode() == "starting", number
        bench.vehicle.script((0.0, BATTERY, {}))
        bench.rest(0.13)
    assert bench.mode() == "standby"
    bench.vehicle.resume(BATTERY)
    bench.drive(throttle_pct=20)
    asked = time.monotonic()
    bench.pedals = None
    assert bench.gateway.terminate() == 0
    ended = time.monotonic()
    bench.rest(0.2)
    frames = bench.commands(asked + GRACE_S)
    for controller in wire.COMMANDS:
        of_one = [f for f in frames if f.can_id == controller]
        assert len(of_one) >= 3
        assert all(f.data == wire.ZERO_TORQUE for f in of_one)
    assert frames[-1].t < ended


def test_every_50_ms_each_controller_gets_exactly_one_frame(bench):
    bench.vehicle.full_rate()
    since = time.monotonic()
    bench.rest(2.6)
    for controller in wire.COMMANDS:
        times = [f.t for f in bench.commands(since) if f.can_id == controller]
        assert abs(times[40] - times[0] - 2.0) < 0.020, f"{times[40] - times[0]:.3f} s"


def cut_in_reverse(bench: Bench) -> None:
    bench.drive(throttle_pct=10)
    bench.demand(throttle_pct=10, motor_reverse=True)
    bench.wait(lambda: bench.command().reverse, "reverse", 1.0)
    bench.vehicle.script((0.0, BATTERY, {"InternalFault": 1}), (0.2, BATTERY, {}))
    bench.rest(0.4)
    assert bench.command() == wire.Command.of(wire.safe_frame(reverse=1, cut=1))
    bench.let_go()


@pytest.fixture
def cut_bench(own_bench):
    own_bench.run(fresh=True)
    own_bench.standby()
    return own_bench


def test_a_latched_cut_and_the_direction_survive_a_kill_and_an_orderly_end(cut_bench, figures):
    bench = cut_bench
    cut_in_reverse(bench)
    bench.vehicle.silence("PCU1_Status1", "PCU2_Status1")
    bench.gateway.kill()
    wanted = wire.safe_frame(reverse=1, cut=1)
    kept = []
    first = first_frames(bench, again(bench))
    kept.append(all(f.data == wanted for f in first))
    figures.append(
        f"kill -9 with a latched CUT, then: {first[0].data.hex()}, wanted {wanted.hex()}"
    )
    assert kept[-1]
    bench.connect()
    assert bench.mode() == "fault"
    asked = time.monotonic()
    assert bench.gateway.terminate() == 0
    frames = bench.commands(asked)
    assert len(frames) >= 6
    assert all(f.data == wanted for f in frames)
    first = first_frames(bench, again(bench))
    assert all(f.data == wanted for f in first)
    bench.connect()
    bench.vehicle.resume("PCU1_Status1", "PCU2_Status1")
    bench.demand()
    bench.rest(1.2)
    assert bench.client.refusal("reset"), "driver level"
    bench.service_reset()
    bench.wait(lambda: not bench.command().cut, "no power cut", 1.0)
    bench.rest(0.2)
    bench.gateway.kill()
    first = first_frames(bench, again(bench))
    assert not any(f.command.cut for f in first), "the latch had been reset"
    bench.connect()


def test_it_begins_in_the_direction_that_the_controllers_echo(cut_bench):
    bench = cut_bench
    bench.drive(throttle_pct=0)
    bench.demand(throttle_pct=0, motor_reverse=True)
    bench.wait(lambda: bench.command().reverse, "reverse", 1.0)
    bench.let_go()
    bench.gateway.kill()
    for pcu in ("PCU1", "PCU2"):
        bench.vehicle.echo(pcu, reverse=0)
    first = first_frames(bench, again(bench))
    assert all(f.data == wire.ZERO_TORQUE for f in first)
    bench.gateway.kill()
    for pcu in ("PCU1", "PCU2"):
        bench.vehicle.echo(pcu, reverse=1)
    first = first_frames(bench, again(bench))
    assert all(f.data == wire.safe_frame(reverse=1) for f in first)
    bench.connect()


def test_overcharge_keeps_regeneration_off_until_a_restart_though_it_was_fleeting(cut_bench):
    bench = cut_bench
    bench.vehicle.script((0.0, BATTERY, {"CellOvervoltage": 3}), (0.001, BATTERY, {}))
    bench.rest(1.4)
    why = bench.why()
    assert any(c["effect"] == "regen off" for c in why["limits"]), why["sentence"]
    bench.speeds(1000)
    bench.arm()
    bench.demand(throttle_pct=10, brake_pct=30, regen_brake=True)
    bench.rest(0.4)
    assert bench.command().throttle
    assert (bench.command().regen, bench.command().brake) == (0, 0)
    bench.speeds(0)


def test_the_sources_are_bounded(cut_bench):
    bench = cut_bench
    bench.release()
    granted = 1
    for number in range(70):
        refusal = bench.client.refused_demand(f"source{number}")
        if refusal is not None:
            assert refusal == "too_many_sources"
            break
        granted += 1
        bench.client.call("demand.release", source=f"source{number}")
    assert granted == 64


def abstract_names() -> set[str]:
    lines = Path("/proc/net/unix").read_text().splitlines()
    return {line.split()[-1] for line in lines if line.split()[-1].startswith("@")}


def squatter(names: set[str]) -> int:
    """A process without privilege that has these names; its id."""
    child = os.fork()
    if child:
        return child
    try:
        os.setgid(65534)
        os.setuid(65534)
        held = []
        for name in names:
            held.append(socket.socket(socket.AF_UNIX))
            held[-1].bind("\0" + name[1:].rstrip("@"))
            held[-1].listen()
        time.sleep(60)
    finally:
        os._exit(0)


def test_an_unprivileged_process_that_binds_its_lock_does_not_keep_it_from_starting(own_bench):
    bench = own_bench
    before = abstract_names()
    bench.run(fresh=True)
    names = abstract_names() - before
    bench.end()
    child = squatter(names)
    try:
        time.sleep(0.2)
        assert names <= abstract_names()
        since = time.monotonic()
        bench.run(fresh=True)
        assert first_frames(bench, since)
    finally:
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


WRONG = {
    "limits": {
        "speed_limit_max_rpm": 499, "power_limit_max_w": 60001, "derated_power_w": 30001,
        "regen_limit_pct": 51, "throttle_slew_pct_per_s": 201, "power_slew_w_per_s": 120001,
        "regen_slew_pct_per_s": 201, "direction_change_rpm": 101, "speed_slew_rpm_per_s": 20001,
        "regen_min_rpm": 1001,
    },
    "safety": {
        "listen_before_talk_ms": 999, "qualify_frames": 2, "clear_hold_ms": 999,
        "echo_below_max_pct": 51, "motor_speed_step_max_rpm": 12001,
    },
    "demand": {"ttl_max_ms": 1001, "ttl_default_ms": 1001},
}  # fmt: skip


def refused_words(folder: Path, sections: dict) -> str:
    file = folder / "wrong.yaml"
    file.write_text(configuration(folder, sections))
    done = subprocess.run(
        [sys.executable, "-m", "vcu_gateway", "check-config", "-c", str(file)],
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 78, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_a_limit_is_not_looser_than_its_maximum(tmp_path):
    words = refused_words(tmp_path, WRONG)
    missing = [key for keys in WRONG.values() for key in keys if key not in words]
    assert not missing


def test_the_deadline_of_a_required_message_is_at_most_twice_its_default(tmp_path):
    looser = {"BMS_Status": 3201, "PCU1_Status2": 401}
    words = refused_words(tmp_path, {"freshness": {"stale_after_ms": looser}})
    assert "BMS_Status" in words
    assert "PCU1_Status2" in words
