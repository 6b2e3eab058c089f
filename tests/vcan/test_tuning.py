"""Tuning on a real bus: a hot motor, its sensor lost, a mode at full pedal, a reload while driving.

By the bytes that a recorder of its own saw.
"""

import itertools
import time
from collections.abc import Iterator

import pytest

from tests.vcan.conftest import COMMANDS, PATIENCE_S, Recorded, Stand, ended_after, wait_until
from tests.vcan.test_api import Drive, begin
from vcu_gateway.client import Client, ConfigRefusedError

HOT_W, STRICTER_W, DERATED_W = 6000, 5000, 4000
STEP_W = 60_000 // 20 + 1  # of the slew in a tick, rounded
HEATS_S, BREAKS_S = 10, 32
SCENARIO = f"""
steps:
  - {{at_s: 0, fault: silence, of: IMU}}
  - {{at_s: {HEATS_S}, fault: set, signal: PCU1_Status1.MotorTemperature, raw: 110}}
  - {{at_s: {BREAKS_S}, fault: silence, of: PCU1_Status1}}
"""


def config(hot_w: int) -> str:
    return f"""
limits: {{power_limit_max_w: 14000, derated_power_w: {DERATED_W}}}
curves: {{power_limit_w: {{by_motor_temperature_c: [[95, 14000], [110, {hot_w}]]}}}}
drive_modes:
  start: eco
  modes:
    eco: {{throttle_pct: {{by_pedal_pct: [[0, 0], [100, 50]]}}}}
    sport: {{}}
"""


def power_w(frame: Recorded) -> int:
    return int.from_bytes(frame.data[6:8], "little")


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Drive]:
    with ended_after(Stand(tmp_path_factory.mktemp("tuned"), forking=True)) as stand:
        yield begin(stand, config(HOT_W), SCENARIO)


def until_power(drive: Drive, watts: int) -> None:
    """Until the last frame of each controller has this PowerLimit."""

    def has() -> bool:
        last = {frame.can_id: power_w(frame) for frame in drive.recording.commands()[-10:]}
        return last == dict.fromkeys(COMMANDS, watts)

    wait_until(has, f"{watts} W for both")


def reloaded(drive: Drive, hot_w: int) -> tuple[str, ...]:
    """The problems of a reload with this curve; none where it is taken."""
    drive.stand.configure(config(hot_w))
    with Client(drive.stand.socket_path, timeout_s=PATIENCE_S) as client:
        try:
            client.reload()
        except ConfigRefusedError as error:
            return tuple(error.problems)
    return ()


@pytest.mark.ci
def test_a_whole_tuned_drive(drive: Drive, figures: list[str]):
    drive.owner(throttle_pct=80.0)
    with drive.client as client:
        wait_until(lambda: drive.last_throttle() == 103, "the throttle of the map: 40 %")

        # Another mode at full pedal: map and power mode wait for its release.
        client.set_drive_mode("sport")
        asked_ns = time.time_ns()
        frames = drive.commands_since(asked_ns, 20)
        assert {frame.data[1] for frame in frames} == {103}
        assert client.tuning()["drive_mode"]["current"] == "eco"

        # A motor becomes hot: both limits come down along the slew.
        until_power(drive, HOT_W)
        for can_id in COMMANDS:
            own = [power_w(one) for one in drive.recording.commands() if one.can_id == can_id]
            falls = [before - after for before, after in itertools.pairwise(own)]
            assert max(falls) <= STEP_W
        assert "motor temperature 110 °C: power at most 6.0 kW" in client.why()["sentence"]

        # A stricter curve is taken while driving, a looser one is not.
        assert reloaded(drive, STRICTER_W) == ()
        until_power(drive, STRICTER_W)
        (refusal,) = reloaded(drive, HOT_W)
        assert refusal == (
            "curves.power_limit_w.by_motor_temperature_c may only become a curve that is nowhere"
            " higher while active"
        )

        # Its sensor is lost: the derated power, and no more than before.
        until_power(drive, DERATED_W)
        limits = [one["cause"] for one in client.why()["limits"]]
        assert "curves.power_limit_w.by_motor_temperature_c" in limits
        after = [one for one in drive.recording.commands() if one.stamp_ns > asked_ns]
        # Where the machine stood still the motors stop, and that releases the pedal.
        held = itertools.takewhile(lambda one: one.data[1], after)
        assert {one.data[1] for one in held} == {103}

    # Let go: the mode that was asked for counts.
    for worker in drive.stand.workers:
        worker.kill()
    with drive.client as client:
        wait_until(lambda: client.tuning()["drive_mode"]["current"] == "sport", "sport")
    figures.append(f"{len(after)} commands of a tuned drive, PowerLimit never above its slew")
