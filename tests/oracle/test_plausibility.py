"""Freshness of everything else, echoes that contradict, values that cannot be."""

import time

import pytest

from tests.oracle import wire
from tests.oracle.bench import GRACE_S, Bench

LEFT, RIGHT = "PCU1_Status1", "PCU2_Status1"
TICK_S = 0.050


def causes(bench: Bench, kind: str) -> list[dict]:
    return bench.why()[kind]


@pytest.mark.parametrize("pcu", ["PCU1", "PCU2"])
def test_a_controller_that_does_not_answer_for_200_ms_stops_both(bench, pcu):
    bench.drive(throttle_pct=20)
    message = f"{pcu}_Status2"
    bench.rest(0.01)
    bench.vehicle.silence(message)
    bench.rest(0.4)
    last = bench.recorder.of(message)[-1].t
    frames = bench.commands(last)
    torque = [f for f in frames if not bench.is_safe(f.command)]
    safe = [f for f in frames if bench.is_safe(f.command)]
    assert safe[0].t > last + 0.2 - 0.001
    assert torque[-1].t < last + 0.2 + GRACE_S
    assert {f.can_id for f in safe} == set(wire.COMMANDS)
    assert {f.data for f in safe} == {wire.ZERO_TORQUE}
    assert bench.mode() == "fault"


@pytest.mark.parametrize("message", [LEFT, RIGHT])
def test_a_status_1_silent_for_1600_ms_limits(bench, message):
    bench.drive(throttle_pct=20, power_mode="turbo")
    last = bench.frame(message, time.monotonic()).t  # one that came before drove without turbo
    bench.vehicle.silence(message)
    bench.until(last + 1.8)
    frames = bench.commands(last)
    eco = [f for f in frames if f.command.power_mode == wire.ECO]
    turbo = [f for f in frames if f.command.power_mode == wire.TURBO]
    assert eco[0].t > last + 1.6 - 0.001
    assert turbo[-1].t < last + 1.6 + GRACE_S
    assert eco[-1].command.power_limit < 60000
    effects = {c["effect"] for c in causes(bench, "limits") if message in c["subject"]}
    assert effects == {"turbo off", "power limit"}


SILENT = [
    ("IMU_Attitude", 0.1), ("IMU_Acceleration", 0.1), ("IMU_AngularRate", 0.1),
    ("ARD2_SteeringWheel", 0.3), ("BMS_Temperatures", 1.6),
]  # fmt: skip


@pytest.mark.parametrize(("message", "bound_s"), SILENT)
def test_another_message_that_is_silent_is_told_at_its_bound(bench, message, bound_s):
    bench.drive(throttle_pct=20)
    bench.vehicle.full_rate()
    bench.rest(0.1)
    bench.vehicle.silence(message)
    bench.pump()
    last = bench.recorder.last[wire.IDENTIFIERS[message]]

    def told():
        return any(message in c["subject"] for c in causes(bench, "alarms"))

    bench.until(last + bound_s - 0.025)
    asked = time.monotonic()
    if told():
        assert asked > last + bound_s, f"told {asked - last:.3f} s after the last"
    bench.until(last + bound_s + TICK_S + 0.03)
    assert told()
    assert bench.mode() == "active"


def test_a_message_that_the_configuration_requires_stops_at_its_bound(bench, reloaded):
    required = ["BMS_Status", "PCU1_Status2", "PCU2_Status2", "ARD2_SteeringWheel"]
    reloaded(safety={"required_messages": required})
    bench.standby()

    bench.drive(throttle_pct=20)
    bench.vehicle.silence("ARD2_SteeringWheel")
    bench.pump()
    last = bench.recorder.of("ARD2_SteeringWheel")[-1].t
    bench.until(last + 0.45)
    torque = [f.t for f in bench.commands(last) if not bench.is_safe(f.command)]
    assert 0.3 - TICK_S - 0.01 <= torque[-1] - last <= 0.3 + GRACE_S
    assert bench.mode() == "fault"


def test_an_echo_of_more_throttle_than_commanded_stops_at_its_bound(bench):
    """20 % is sent as 19.89 %: 24.57 % (63) is within 5 %, 24.96 % (64) beyond."""
    bench.drive(throttle_pct=20)
    bench.rest(0.6)
    bench.vehicle.echo("PCU2", throttle=63)
    bench.vehicle.set(RIGHT)
    bench.rest(0.15)
    assert bench.mode() == "active"
    since = time.monotonic()
    bench.vehicle.echo("PCU2", throttle=64)
    bench.vehicle.set(RIGHT)
    bench.must_be_safe_after(bench.frame(RIGHT, since).t, wire.ZERO_TORQUE)
    assert bench.mode() == "fault"


def test_an_echo_of_what_was_commanded_within_the_last_second_is_none(bench):
    bench.drive(throttle_pct=60)
    bench.demand(throttle_pct=10)
    bench.rest(0.7)
    bench.vehicle.echo("PCU1", throttle=wire.percent(60))
    bench.vehicle.set(LEFT)
    bench.rest(0.12)
    assert bench.mode() == "active"


def test_one_controller_that_echoes_too_little_throttle_twice_stops(bench):
    """40 % is sent as 40.17 %: 25.35 % (65) is within 15 %, 24.96 % (64) beyond."""
    bench.drive(throttle_pct=40)
    bench.rest(1.1)
    bench.vehicle.echo("PCU1", throttle=65)
    bench.vehicle.set(LEFT)
    bench.rest(1.1)
    assert bench.mode() == "active"
    bench.vehicle.echo("PCU1", throttle=64)
    bench.vehicle.set(LEFT)
    bench.rest(0.3)
    assert bench.mode() == "active", "once"
    since = time.monotonic()
    second = bench.frame(LEFT, since).t
    bench.must_be_safe_after(second, wire.ZERO_TORQUE)
    assert bench.mode() == "fault"


def test_both_controllers_that_echo_too_little_throttle_are_told_and_go_on(bench):
    bench.drive(throttle_pct=40)
    bench.rest(1.1)
    since = time.monotonic()
    for pcu in ("PCU1", "PCU2"):
        bench.vehicle.echo(pcu, throttle=0)
    bench.vehicle.set(LEFT)
    bench.vehicle.set(RIGHT)
    bench.until(since + 0.75)
    assert bench.mode() == "active"
    assert len(causes(bench, "alarms")) >= 2
    assert bench.command().throttle == wire.percent(40)


def test_a_controller_that_follows_a_rising_throttle_late_is_no_cause(bench):
    bench.drive(throttle_pct=0)
    for pcu in ("PCU1", "PCU2"):
        bench.vehicle.echo(pcu, throttle=0)
    bench.demand(throttle_pct=90)
    bench.rest(0.9)
    assert bench.mode() == "active"


def test_an_echo_of_the_other_direction_twice_stops(bench):
    bench.drive(throttle_pct=20)
    bench.rest(1.2)
    bench.vehicle.echo("PCU2", reverse=1)
    bench.vehicle.set(RIGHT)
    bench.rest(0.3)
    assert bench.mode() == "active", "once"
    second = bench.frame(RIGHT, time.monotonic()).t
    bench.must_be_safe_after(second, wire.ZERO_TORQUE)
    assert bench.mode() == "fault"


def test_a_change_of_direction_that_is_echoed_late_is_no_cause(bench):
    bench.drive(throttle_pct=10)
    for pcu in ("PCU1", "PCU2"):
        bench.vehicle.echo(pcu, reverse=0)
    bench.demand(throttle_pct=10, motor_reverse=True)
    bench.wait(lambda: bench.command().reverse, "reverse", 1.0)
    for _ in range(2):
        bench.rest(0.4)
        bench.vehicle.set(LEFT)
        bench.vehicle.set(RIGHT)
    bench.rest(0.12)
    assert bench.mode() == "active"
    for pcu in ("PCU1", "PCU2"):
        bench.vehicle.echo(pcu)
    bench.rest(0.6)
    bench.demand(throttle_pct=10)
    bench.wait(lambda: not bench.command().reverse, "forward", 1.0)


def speed_alarms(bench: Bench, subject: str) -> bool:
    return any(subject in c["subject"] for c in causes(bench, "alarms"))


def test_a_motor_speed_that_leaps_is_told_and_unknown_for_three_frames(bench):
    bench.speeds(1000)
    bench.drive(throttle_pct=10, brake_pct=20, regen_brake=True)
    bench.wait(lambda: bench.command().regen, "regeneration", 3.0)
    bench.speeds(3000, 1000)
    bench.rest(0.2)
    assert not speed_alarms(bench, "PCU1"), "2000 rpm is the bound"
    bench.speeds(1000)
    bench.rest(0.2)
    since = time.monotonic()
    bench.speeds(3002, 1000)
    leap = bench.frame("PCU1_Status2", since, lambda d: d[6] + 256 * d[7] == 3002).t
    bench.until(leap + 0.45)
    assert speed_alarms(bench, "PCU1")
    status = [f.t for f in bench.recorder.of("PCU1_Status2", leap)]
    unknown = [f for f in bench.commands(leap + GRACE_S, status[3]) if f.t > leap]
    assert len(unknown) >= 4
    assert not any(f.command.regen for f in unknown)
    assert bench.command().regen
    assert bench.mode() == "active"
    bench.speeds(1500, 1000)
    bench.rest(0.2)
    bench.speeds(0)
    bench.rest(0.1)


def test_a_wheel_speed_that_leaps_is_told(bench):
    bench.vehicle.set("ARD2_SteeringWheel", WheelSpeedFL=39.9)
    bench.vehicle.set("ARD2_SteeringWheel", WheelSpeedFR=39.9)
    bench.rest(0.12)
    assert not speed_alarms(bench, "ARD2")
    bench.vehicle.set("ARD2_SteeringWheel", WheelSpeedFL=19.8)
    bench.vehicle.set("ARD2_SteeringWheel", WheelSpeedFL=39.9)
    bench.rest(0.12)
    assert speed_alarms(bench, "ARD2")
    bench.vehicle.set("ARD2_SteeringWheel", WheelSpeedFL=20, WheelSpeedFR=20)


def test_wheel_speeds_that_differ_for_a_second_are_told(bench):
    bench.vehicle.set("ARD2_SteeringWheel", WheelSpeedFL=34.9, WheelSpeedFR=20)
    bench.rest(1.2)
    assert not speed_alarms(bench, "ARD2")
    since = time.monotonic()
    bench.vehicle.set("ARD2_SteeringWheel", WheelSpeedFL=35.1)
    bench.until(since + 0.9)
    assert not speed_alarms(bench, "ARD2")
    bench.until(since + 1.3)
    assert speed_alarms(bench, "ARD2")


def test_a_required_signal_out_of_range_is_told_and_its_value_not_used(bench):
    """A motor speed that is not known does not let the direction change."""
    bench.vehicle.set("BMS_Status", SOC=101)
    bench.rest(0.12)
    assert speed_alarms(bench, "BMS_Status.SOC")
    bench.vehicle.set("BMS_Status", SOC=80)
    for rpm in (1900, 3800, 5700, 6001):
        bench.speeds(rpm, rpm)
        bench.rest(0.12)
    assert speed_alarms(bench, "MotorSpeed")
    for rpm in (5700, 3800, 1900):
        bench.speeds(rpm)
        bench.rest(0.12)


def test_wrong_frames_are_counted_and_change_nothing(bench):
    def rejected() -> int:
        return sum(bench.client.call("health")["frames"]["rejected"].values())

    before = rejected()
    bad = wire.bms_status({**wire.BMS_HEALTHY, "InternalFault": 1}, 1)
    status = wire.IDENTIFIERS["BMS_Status"]
    remote = wire.packed(status | 0x4000_0000, b"")
    bench.vehicle.script(
        (0.0, None, wire.packed(status, bad[:7])), (0.002, None, wire.packed(status, b"")),
        (0.004, None, remote),
    )  # fmt: skip
    bench.rest(0.15)
    assert bench.mode() == "standby"
    assert rejected() >= before + 2
