"""Curves, drive modes and the slip limiter of one tuned gateway, by docs/safety.md, Tuning."""

import time
from itertools import pairwise
from typing import Any

import pytest

from tests.oracle import tuned, wire
from tests.oracle.bench import GRACE_S
from tests.oracle.tuned import ask, at, drive, motor_speed, motors, must_ramp, stays, tell, wheels
from tests.oracle.watching import TICK_S, of_pcu1, settled, throttles_stay_zero

SECTIONS, RETURN, SPEED_FALL = tuned.SECTIONS, tuned.RETURN_PER_S, tuned.SPEED_FALL_RPM_S
PCT = 1 / 0.39  # of a byte of the command
BATTERY, PACKS, WHEELS = "BMS_Status", "BMS_Temperatures", "ARD2_SteeringWheel"
LEFT, RIGHT = "PCU1_Status1", "PCU2_Status1"


def test_power_follows_the_hotter_motor_and_returns_at_its_own_rate(bench):
    drive(bench, throttle_pct=20)
    told = tell(bench, RIGHT, MotorTemperature=90)
    must_ramp(bench, told, "power_limit", at(tuned.MOTOR_C, 90))
    why = bench.why()
    key = "curves.power_limit_w.by_motor_temperature_c"
    assert any(key in str(cause) and cause["effect"] == "cap" for cause in why["limits"]), why
    told = tell(bench, LEFT, MotorTemperature=110)
    must_ramp(bench, told, "power_limit", at(tuned.MOTOR_C, 110))
    bench.vehicle.set(RIGHT, MotorTemperature=50)
    stays(bench, power_limit=20000)
    told = tell(bench, LEFT, MotorTemperature=90)
    must_ramp(bench, told, "power_limit", at(tuned.MOTOR_C, 90), RETURN["power_limit"])


def test_motor_temperatures_that_differ_by_more_than_40_c_are_told(bench):
    for celsius, differ in ((90, False), (91, True)):
        bench.vehicle.set(RIGHT, MotorTemperature=celsius)
        bench.rest(0.12)
        alarms = bench.why()["alarms"]
        assert bool(alarms) == differ, (celsius, alarms)


def test_of_an_inputs_signals_the_worst_counts_and_of_several_curves_the_lowest(bench):
    drive(bench, throttle_pct=20)
    for message, signal, value, curve in (
        ("PCU1_Status2", "BatteryVoltage", 50, tuned.VOLTS),
        (PACKS, "PackTemperature3", 47, tuned.HOTTEST_PACK_C),
        (RIGHT, "MotorTemperature", 90, tuned.MOTOR_C),
        (PACKS, "PackTemperature5", 0, tuned.COLDEST_PACK_C),
        (LEFT, "ControllerTemperature", 70, tuned.CONTROLLER_C),
        (BATTERY, "SOC", 25, tuned.SOC),
    ):
        told = tell(bench, message, **{signal: value})
        must_ramp(bench, told, "power_limit", at(curve, value))


@pytest.mark.parametrize(
    ("signal", "value", "held"),
    [("MotorTemperature", 90, 40000), ("ControllerTemperature", 151, tuned.DERATED_W)],
    ids=["hot", "marked"],
)
def test_one_frame_between_two_ticks_counts_and_the_return_begins_at_once(
    bench, signal, value, held
):
    """PowerLimit comes down by 3000 W a tick and meets the limit, which returns by 1500 W."""
    drive(bench, throttle_pct=20)
    since = time.monotonic()
    bench.vehicle.script((0.0, LEFT, {signal: value}), (0.002, LEFT, {}), after_tick_ms=20)
    powers = [f.command.power_limit for f in bench.ticks(since, 20)]
    low = powers.index(min(powers))
    down = (60000 - held) / (3000 + 1500)
    assert abs(powers[low] - (60000 - 3000 * down)) <= 2500, powers
    assert all(1000 <= b - a <= 1501 or b == 60000 for a, b in pairwise(powers[low + 1 :])), powers


def test_a_marked_input_limits_and_never_raises_also_in_standby(bench):
    low = at(tuned.CONTROLLER_C, 85)
    for celsius in (85, 151):
        told = tell(bench, LEFT, ControllerTemperature=celsius)
        bench.ticks(told + GRACE_S, 1)
    bench.arm()
    bench.demand(throttle_pct=20)
    bench.wait(lambda: bench.command().throttle == wire.percent(20), "throttle", 1.0)
    assert max(f.command.power_limit for f in bench.commands(told)) == low
    told = tell(bench, LEFT, ControllerTemperature=75)
    must_ramp(bench, told, "power_limit", at(tuned.CONTROLLER_C, 75), RETURN["power_limit"])
    told = tell(bench, RIGHT, ControllerTemperature=151)
    must_ramp(bench, told, "power_limit", tuned.DERATED_W)
    bench.vehicle.set(RIGHT, ControllerTemperature=85)
    bench.wait(lambda: bench.command().power_limit == low, "3000 W", 1.0)
    bench.vehicle.set(RIGHT, ControllerTemperature=151)
    stays(bench, power_limit=low)


def test_an_input_that_is_stale_goes_to_the_derated_power(bench):
    drive(bench, throttle_pct=20)
    last = bench.frame(PACKS, time.monotonic()).t
    bench.vehicle.silence(PACKS)
    stale = last + tuned.STALE_S
    assert must_ramp(bench, stale, "power_limit", tuned.DERATED_W) > stale - 0.001
    assert bench.mode() == "active"


def test_where_a_curve_comes_to_0_w_the_throttle_is_0_and_not_before(bench):
    drive(bench, throttle_pct=20)
    told = tell(bench, LEFT, ControllerTemperature=95)
    must_ramp(bench, told, "power_limit", 0)
    stays(bench, 0.1, power_limit=0, throttle=0)
    for frame in bench.commands(told - TICK_S):
        assert (frame.command.throttle > 0) == (frame.command.power_limit > 0), frame.command


def test_brake_follows_the_charge_and_a_cap_of_0_takes_regeneration(bench):
    motors(bench, 1000)
    drive(bench, brake_pct=100, regen_brake=True)
    bench.vehicle.set(BATTERY, SOC=60)
    stays(bench, brake=wire.percent(at(tuned.BRAKE_SOC, 60)), regen=1)
    told = tell(bench, BATTERY, SOC=101)  # marked
    must_ramp(bench, told, "brake", wire.percent(tuned.REGEN_LIMIT_PCT))
    told = tell(bench, BATTERY, SOC=95)
    must_ramp(bench, told, "brake", 0)
    stays(bench, 0.1, brake=0, regen=0)
    told, some = tell(bench, BATTERY, SOC=93), wire.percent(at(tuned.BRAKE_SOC, 93))
    must_ramp(bench, told, "brake", some, RETURN["brake"])
    bench.vehicle.set(BATTERY, SOC=101)
    stays(bench, brake=some, regen=1)


def test_a_modes_speed_limit_comes_down_slowly_under_throttle_and_is_at_least_500_rpm(bench):
    drive(bench, throttle_pct=30)
    must_ramp(bench, ask(bench, "pit"), "speed_limit", 500, SPEED_FALL)
    bench.demand(throttle_pct=30, speed_limit_rpm=0)
    stays(bench, speed_limit=500, throttle=wire.percent(30))
    ask(bench, "plain")
    bench.demand()
    must_ramp(bench, time.monotonic(), "speed_limit", tuned.RPM_MAX, RETURN["speed_limit"])
    must_ramp(bench, ask(bench, "pit"), "speed_limit", 500, SPEED_FALL)
    bench.client.call("estop")  # in other modes it is that of the safe frames
    bench.must_be_safe_after(time.monotonic(), wire.safe_frame(tuned.RPM_MAX, cut=1))


def test_a_speed_limit_over_charge_comes_down_and_stays_where_the_charge_is_unknown(bench):
    drive(bench, throttle_pct=20)
    told = tell(bench, BATTERY, SOC=32)
    must_ramp(bench, told, "speed_limit", at(tuned.SPEED_SOC, 32), SPEED_FALL)
    bench.vehicle.set(BATTERY, SOC=101)
    stays(bench, speed_limit=at(tuned.SPEED_SOC, 32))


def test_in_standby_arming_waits_for_the_speed_limit_which_is_quick_at_slow_motors(bench):
    motors(bench, 600)
    asked = ask(bench, "city")
    assert bench.client.refusal("arm")
    must_ramp(bench, asked, "speed_limit", 30 * tuned.RPM_PER_KMH)
    asked = ask(bench, "pit")
    bench.ticks(asked, 4)
    assert bench.client.refusal("arm")
    must_ramp(bench, asked, "speed_limit", 500, SPEED_FALL)
    bench.arm()


def test_a_pedal_map_gives_its_throttle_and_pedal_rules_see_the_demand(bench):
    drive(bench, "city", throttle_pct=100)
    for pct in (100, 90, 75, 50, 30, 10):
        mapped = wire.percent(at(tuned.CITY, pct))
        assert settled(bench, {"throttle_pct": pct}).throttle == mapped, pct
    bench.demand(controllers={"PCU1": {"throttle_pct": 75}, "PCU2": {"throttle_pct": 50}})
    bench.wait(lambda: bench.command().throttle == wire.percent(20), "20 %", 1.0)
    bench.rest(0.3)
    assert [f.command.throttle for f in bench.last_pair()] == [wire.percent(40), wire.percent(20)]
    bench.demand(throttle_pct=30, brake_pct=6)  # by the map it would be 12 %
    assert throttles_stay_zero(bench, 0.2)


FOOT: dict[str, Any] = {"throttle_pct": 20, "brake_pct": 60, "power_mode": "turbo"}


def test_limits_of_a_new_mode_count_at_once_and_its_map_from_the_release_on(bench):
    motors(bench, 1000)
    drive(bench, **FOOT)
    asked = ask(bench, "city")
    must_ramp(bench, asked, "power_limit", 30000)
    must_ramp(bench, asked, "brake", wire.percent(30))
    must_ramp(bench, asked, "speed_limit", 30 * tuned.RPM_PER_KMH, SPEED_FALL)
    stays(bench, 0.1, throttle=wire.percent(20), power_mode=wire.TURBO)
    assert any("city" in one for one in bench.why()["waits"]), bench.why()
    one, other = {**FOOT, "throttle_pct": 4.9}, {**FOOT, "throttle_pct": 5}
    bench.demand(controllers={"PCU1": one, "PCU2": other})
    bench.rest(0.12)
    pair = [(f.command.throttle, f.command.power_mode) for f in bench.last_pair()]
    assert pair == [(wire.percent(4.9), wire.TURBO), (wire.percent(5), wire.TURBO)]
    assert settled(bench, {**FOOT, "throttle_pct": 4.9}).power_mode == wire.NORMAL
    bench.demand(**FOOT)
    mapped = wire.percent(at(tuned.CITY, 20))
    bench.wait(lambda: bench.command().throttle == mapped, "the map", 1.0)

    ask(bench, "plain")
    stays(
        bench, throttle=mapped, brake=wire.percent(30), power_mode=wire.NORMAL,
        speed_limit=1500, power_limit=30000,
    )  # fmt: skip
    bench.demand(**{**FOOT, "throttle_pct": 0})
    must_ramp(bench, time.monotonic(), "brake", wire.percent(60), RETURN["brake"])
    assert {f.command.power_mode for f in bench.last_pair()} == {wire.TURBO}


def test_a_mode_left_by_service_and_one_that_is_none_are_refused(bench):
    ask(bench, "valet")
    for mode, refusal in (("plain", "not_allowed_now"), ("plane", "no_such_mode")):
        refused = bench.client.refusal("drive_mode.set", mode=mode)
        assert refused is not None
        assert refused.refusal == refusal
    assert bench.client.refusal("drive_mode.set", mode="plain", level="service") is None


def test_throttle_and_its_rise_follow_the_faster_front_wheel_and_a_saturated_one(bench):
    drive(bench, "rain")
    bench.demand(throttle_pct=100)
    must_ramp(bench, time.monotonic(), "throttle", wire.percent(45), at(tuned.RAIN_RISE, 20) * PCT)
    slow, again = {"WheelSpeedFL": 10, "WheelSpeedFR": 10}, {}
    since = time.monotonic()
    bench.vehicle.script((0.0, WHEELS, slow), (0.002, WHEELS, again), after_tick_ms=20)
    lowest = min(f.command.throttle for f in bench.ticks(since, 4))
    assert lowest == wire.percent(at(tuned.RAIN, 10)), "of several frames the lowest"
    bench.vehicle.set(WHEELS, WheelSpeedFR=30)
    bench.wait(lambda: bench.command().throttle == wire.percent(at(tuned.RAIN, 30)), "30 km/h", 1.0)
    bench.demand()
    wheels(bench, 35, 50, 65.535)
    bench.demand(throttle_pct=100)
    must_ramp(bench, time.monotonic(), "throttle", wire.percent(90))


def test_without_front_wheels_throttle_and_rise_go_to_the_lowest_of_the_mode(bench):
    drive(bench, "rain", throttle_pct=100)
    bench.vehicle.silence(WHEELS)
    bench.pump()
    stale = bench.recorder.of(WHEELS)[-1].t + 0.3
    began = must_ramp(bench, stale, "throttle", wire.percent(30))
    assert began > stale - 0.001
    bench.rest(0.15)
    bench.demand()
    bench.rest(0.12)
    bench.demand(throttle_pct=15)
    must_ramp(bench, time.monotonic(), "throttle", wire.percent(15), 20 * PCT)


def test_a_wheel_that_spins_is_cut_again_after_the_wait_and_given_back_slowly(bench):
    """With 20 km/h in front 30 km/h are allowed, 1500 rpm; 40 % less each time, at least 10 %."""
    motors(bench, 1000, 1500)
    drive(bench, throttle_pct=60)
    stays(bench, throttle=wire.percent(60))
    since = time.monotonic()
    bench.speeds(1501, 1500)
    told = motor_speed(bench, "PCU1_Status2", since, 1501)
    bench.rest(1.1)
    ticks = bench.commands(told - TICK_S)
    cuts = [(a, b) for a, b in pairwise(of_pcu1(ticks)) if b.command.throttle != a.command.throttle]
    assert [b.command.throttle for _, b in cuts] == [92, 55, 33, 26]  # 60.06 % x 0.6 and so on
    assert told < cuts[0][1].t < told + TICK_S + GRACE_S
    waits = [after.t - before.t for (_, before), (_, after) in pairwise(cuts)]
    assert all(0.240 <= wait <= 0.250 + TICK_S + GRACE_S for wait in waits), waits
    for one, other in pairwise(ticks):
        if other.t - one.t < 0.020:  # of one tick
            most = min(60 * PCT, one.command.throttle + tuned.ASYMMETRY_PCT * PCT)
            assert abs(other.command.throttle - most) <= 1.5, (one.command, other.command)
    since = time.monotonic()
    bench.speeds(1500)
    told = motor_speed(bench, "PCU1_Status2", since, 1500)
    must_ramp(bench, told, "throttle", wire.percent(60), tuned.SLIP_RETURN_PCT_S * PCT)


def test_without_front_wheels_a_slip_cut_stays_until_the_pedals_release(bench):
    motors(bench, 1000)
    drive(bench, throttle_pct=60)
    bench.vehicle.silence(WHEELS)
    bench.rest(0.1)
    bench.speeds(1600, 1000)
    bench.rest(0.2)  # stale before the wait is over: no second cut
    for rpm in (1600, 1000):
        bench.speeds(rpm, 1000)
        since = time.monotonic()
        bench.rest(0.3)
        assert {f.command.throttle for f in of_pcu1(bench.commands(since))} == {92}
    bench.demand()
    bench.rest(0.3)
    bench.demand(throttle_pct=60)
    bench.rest(0.8)
    returned_s = (bench.last_pair()[0].command.throttle / PCT - 36) / tuned.SLIP_RETURN_PCT_S
    assert 0.2 < returned_s < 0.4


def test_with_a_saturated_front_wheel_nothing_is_cut(bench):
    drive(bench, throttle_pct=60)
    wheels(bench, 35, 50, 65.535)
    motors(bench, 1800, 3600, 5000)  # 100 km/h, where 65.5 km/h would allow 86.9
    stays(bench, throttle=wire.percent(60))
