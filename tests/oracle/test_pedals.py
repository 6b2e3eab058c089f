"""From the pedals to the frame: slews, floors, brake over throttle, tracks, direction."""

import itertools
import time

from tests.oracle import wire
from tests.oracle.bench import GRACE_S
from tests.oracle.watching import TICK_S, of_pcu1, rises, settled, throttles_stay_zero


def test_the_throttle_rises_along_its_slew_falls_at_once_and_saturates(bench):
    bench.drive(throttle_pct=0)
    bench.demand(throttle_pct=100)
    since = time.monotonic()
    bench.wait(lambda: bench.command().throttle == 255, "full throttle", 2.0)
    rising = [f for f in of_pcu1(bench.commands(since)) if f.command.throttle < 255]
    took = bench.recorder.commands[-1].t - next(f.t for f in rising if f.command.throttle)
    assert 0.94 <= took <= 1.10, f"{took * 1000:.0f} ms"
    for fewer, more in itertools.pairwise([f.command.throttle for f in rising]):
        assert fewer <= more <= fewer + 13
    asked = time.monotonic()
    bench.demand(throttle_pct=20)
    answered = time.monotonic()
    bench.rest(0.12)
    assert all(f.command.throttle == 51 for f in bench.commands(answered + GRACE_S)), asked


def test_percentages_are_rounded_to_the_nearest_step(bench):
    bench.speeds(1000)
    bench.drive(throttle_pct=0)
    bench.rest(0.2)
    for asked, code in (
        (0.19, 0),
        (0.2, 1),
        (10, 26),
        (33.3, 85),
        (50, 128),
        (99.4, 255),
        (100, 255),
    ):
        assert settled(bench, {"brake_pct": asked}).brake == code, asked


def test_each_controller_may_get_its_own_throttle(bench):
    bench.drive(throttle_pct=0)
    bench.demand(controllers={"PCU1": {"throttle_pct": 10}, "PCU2": {"throttle_pct": 20}})
    bench.rest(0.4)
    last = {f.can_id: f.command.throttle for f in bench.recorder.commands[-2:]}
    assert last == {wire.PCU1_COMMAND: 26, wire.PCU2_COMMAND: 51}


def test_brake_over_throttle_at_its_bounds_and_until_the_release(bench):
    bench.drive(throttle_pct=25, brake_pct=40)
    bench.rest(0.12)
    assert bench.command().throttle == wire.percent(25)
    bench.drive(throttle_pct=26, brake_pct=5)
    bench.rest(0.12)
    assert bench.command().throttle == wire.percent(26)
    bench.demand(throttle_pct=26, brake_pct=5.5)
    assert throttles_stay_zero(bench, 0.2)
    assert bench.why()["waits"], "what the throttle waits for"
    for values in ({"throttle_pct": 26}, {"throttle_pct": 100}, {"throttle_pct": 5}):
        bench.demand(**values)
        assert throttles_stay_zero(bench, 0.2), values
    assert bench.mode() == "active"
    bench.demand(throttle_pct=4.9)
    assert rises(bench)
    bench.demand(throttle_pct=30)
    bench.wait(lambda: bench.command().throttle == wire.percent(30), "throttle", 2.0)


def test_the_direction_waits_for_both_motors_with_throttle_0(bench):
    bench.speeds(49, 60)
    bench.drive(throttle_pct=20)
    bench.demand(throttle_pct=20, motor_reverse=True)
    assert throttles_stay_zero(bench, 0.3)
    assert bench.why()["waits"], "what the throttle waits for"
    assert not bench.command().reverse
    bench.speeds(50, 49)
    bench.rest(0.3)
    assert not bench.command().reverse
    bench.speeds(49, 49)
    bench.wait(lambda: bench.command().reverse, "the other direction", 1.0)
    bench.wait(lambda: bench.command().throttle == wire.percent(20), "throttle", 1.0)
    bench.demand(throttle_pct=20, motor_reverse=False)
    bench.wait(lambda: not bench.command().reverse, "forward again", 1.0)


def test_regeneration_stops_below_its_speed_and_returns_50_rpm_above(bench):
    bench.speeds(150)
    bench.drive(throttle_pct=10, brake_pct=30, regen_brake=True)
    bench.wait(lambda: bench.command().regen, "regeneration", 3.0)
    for rpm1, rpm2, regen in (
        (100, 100, 1), (99, 1000, 0), (149, 1000, 0), (1000, 149, 0), (150, 150, 1),
        (101, 100, 1), (500, 99, 0), (500, 150, 1),
    ):  # fmt: skip
        bench.speeds(rpm1, rpm2)
        bench.rest(0.17)
        assert bench.command().regen == regen, (rpm1, rpm2)
    bench.speeds(500, 80)
    bench.rest(0.17)
    assert bench.command().regen == 0
    bench.demand(throttle_pct=10, brake_pct=30)
    bench.speeds(500)
    bench.rest(0.17)
    assert bench.command().regen == 0


def test_pedal_tracks_that_differ_for_long_take_the_throttle_until_both_are_released(bench):
    bench.drive(throttle_pct=20, throttle_track2_pct=20)
    bench.demand(throttle_pct=20, throttle_track2_pct=29)
    bench.rest(0.4)
    assert bench.command().throttle == wire.percent(20)
    began = time.monotonic()
    bench.demand(throttle_pct=20, throttle_track2_pct=31)
    bench.rest(0.3)
    zero = next(f.t for f in bench.commands(began) if f.command.throttle == 0)
    assert 0.095 <= zero - began <= 0.100 + TICK_S + 0.03, f"{(zero - began) * 1000:.0f} ms"
    for values in (
        {"throttle_pct": 20, "throttle_track2_pct": 20},
        {"throttle_pct": 4, "throttle_track2_pct": 6},
        {"throttle_pct": 6, "throttle_track2_pct": 4},
    ):
        bench.demand(**values)
        assert throttles_stay_zero(bench, 0.2), values
    bench.demand(throttle_pct=4, throttle_track2_pct=4)
    assert rises(bench)
    bench.drive(throttle_pct=20, throttle_track2_pct=20)


def test_pedal_tracks_that_differ_shortly_change_nothing(bench):
    bench.drive(throttle_pct=20, throttle_track2_pct=20)
    since = time.monotonic()
    for _ in range(3):
        bench.demand(throttle_pct=20, throttle_track2_pct=40)
        bench.rest(0.05)
        bench.demand(throttle_pct=20, throttle_track2_pct=20)
        bench.rest(0.08)
    assert all(f.command.throttle == wire.percent(20) for f in bench.commands(since))


def test_the_speed_limit_falls_along_its_slew_to_its_floor_and_no_lower(bench):
    bench.drive(throttle_pct=10)
    assert bench.command().speed_limit == 12000
    since = time.monotonic()
    bench.demand(throttle_pct=10, speed_limit_rpm=0)
    bench.wait(lambda: bench.command().speed_limit == 500, "500 rpm", 4.0)
    ticks = of_pcu1(bench.commands(since))
    falling = [f for f in ticks if f.command.speed_limit < 12000]
    took = falling[-1].t - falling[0].t
    assert 2.6 <= took <= 3.2, f"{took:.2f} s"
    bench.rest(0.15)
    assert bench.command().speed_limit == 500
    bench.demand(throttle_pct=10, speed_limit_rpm=3000)
    bench.wait(lambda: bench.command().speed_limit == 3000, "3000 rpm", 1.5)


def test_the_power_limit_is_as_demanded_below_the_maximum(bench):
    bench.drive(throttle_pct=10)
    bench.demand(throttle_pct=10, power_limit_w=1234)
    bench.wait(lambda: bench.command().power_limit == 1234, "1234 W", 1.5)


def test_power_modes_are_sent_as_asked_and_safety_means_throttle_0(bench):
    bench.drive(throttle_pct=20)
    for mode, code in (("eco", 0), ("normal", 1), ("turbo", 2)):
        assert settled(bench, {"power_mode": mode}).power_mode == code
        bench.drive(throttle_pct=20, power_mode=mode)
        assert bench.command().power_mode == code
    bench.demand(throttle_pct=20, power_mode="safety")
    assert throttles_stay_zero(bench, 0.25)
    assert bench.mode() == "active"


def test_power_mode_falls_at_once_and_rises_only_with_released_throttle(bench):
    bench.drive(throttle_pct=20, power_mode="turbo")
    bench.demand(throttle_pct=20, power_mode="eco")
    bench.rest(0.12)
    since = time.monotonic()
    bench.demand(throttle_pct=20, power_mode="turbo")
    bench.rest(0.4)
    frames = bench.commands(since)
    told = {(f.command.power_mode, f.command.throttle) for f in frames}
    assert told == {(wire.ECO, wire.percent(20))}
    assert "power mode eco until the throttle is below 5 %" in bench.why()["sentence"]
    assert settled(bench, {"throttle_pct": 4.7, "power_mode": "turbo"}).power_mode == wire.TURBO
    bench.drive(throttle_pct=20, power_mode="turbo")
    assert bench.command().power_mode == wire.TURBO


def test_power_mode_stays_where_a_limit_ends_with_throttle(bench):
    bench.drive(throttle_pct=20, power_mode="turbo")
    bench.vehicle.set("PCU1_Status1", TemperatureProtectLevel=1)
    bench.wait(lambda: bench.command().power_mode == wire.NORMAL, "normal", 1.0)
    bench.vehicle.set("PCU1_Status1", TemperatureProtectLevel=0)
    bench.wait(lambda: not bench.why()["limits"], "no limit", 3.0)
    bench.rest(0.2)
    command = bench.command()
    assert (command.power_mode, command.throttle) == (wire.NORMAL, wire.percent(20))
    assert settled(bench, {"throttle_pct": 0, "power_mode": "turbo"}).power_mode == wire.TURBO


def test_power_mode_rises_for_both_controllers_in_the_same_tick(bench):
    bench.drive(throttle_pct=20)
    turbo = {"throttle_pct": 0, "power_mode": "turbo"}
    bench.demand(controllers={"PCU1": turbo, "PCU2": {**turbo, "throttle_pct": 20}})
    bench.rest(0.3)
    assert {f.command.power_mode for f in bench.last_pair()} == {wire.ECO}
    since = time.monotonic()
    bench.demand(**turbo)
    bench.rest(0.3)
    frames = bench.commands(since)
    pairs = [(a, b) for a, b in itertools.pairwise(frames) if b.t - a.t < 0.020]
    assert all(a.command.power_mode == b.command.power_mode for a, b in pairs)
    assert frames[-1].command.power_mode == wire.TURBO


def test_a_stricter_maximum_power_is_reached_along_the_slew(bench, reloaded):
    bench.drive(throttle_pct=10)
    assert bench.command().power_limit == 60000
    since = time.monotonic()
    reloaded(limits={"power_limit_max_w": 40000})
    bench.wait(lambda: bench.command().power_limit == 40000, "40000 W", 2.0)
    powers = [f.command.power_limit for f in of_pcu1(bench.commands(since))]
    assert all(before - after <= 3001 for before, after in itertools.pairwise(powers)), powers
    assert len([p for p in powers if 40000 < p < 60000]) >= 6, powers


def test_a_stricter_maximum_is_reached_along_the_slew(bench, reloaded):
    bench.drive(throttle_pct=10)
    since = time.monotonic()
    reloaded(limits={"speed_limit_max_rpm": 10000})
    bench.wait(lambda: bench.command().speed_limit == 10000, "10000 rpm", 2.0)
    speeds = [f.command.speed_limit for f in of_pcu1(bench.commands(since))]
    assert len([s for s in speeds if 10000 < s < 12000]) >= 7, speeds
    bench.standby()
    assert bench.command().speed_limit == 10000
