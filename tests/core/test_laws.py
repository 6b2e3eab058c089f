"""Curves, drive modes and slip limiter in a whole drive, from a healthy one on."""

import dataclasses
import itertools

import pytest

from tests.core.simulated_drive import MS, Drive, standby
from vcu_gateway.core import calls
from vcu_gateway.core.causes import Effect
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, PowerMode, Refusal
from vcu_gateway.core.deratings import CurveState
from vcu_gateway.core.laws import Laws
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.core.tuning import DERATINGS, DriveMode, SlipLimiter, Tuning

FULL = ControllerDemand(throttle_pct=100, brake_pct=0, power_mode=PowerMode.TURBO)
BRAKING = ControllerDemand(brake_pct=100, power_mode=PowerMode.TURBO)
RPM_PER_KMH = 100.0


def curve(*points) -> Curve:
    return Curve(tuple((float(x), float(y)) for x, y in points))


HOT = curve((95, 60000), (110, 6000), (125, 0))
EXAMPLES = {
    name: Curve(tuple((float(x), float(y)) for x, y in one.example))
    for name, one in DERATINGS.items()
}


def driving(
    demanded=FULL, modes=None, slip=None, *, settings=None, rpm_per_kmh=RPM_PER_KMH, **curves
) -> Drive:
    """An armed drive under this demand, its limits settled; curves by `limit__by_input`."""
    tuning = Tuning(
        {name.replace("__", "."): one for name, one in curves.items()},
        next(iter(modes), None) if modes else None,
        modes or {},
        slip,
        rpm_per_kmh,
    )
    drive = standby(tuning=tuning, **(settings or {}))
    drive.run(2000)
    answer = drive.arm()
    assert answer.granted, answer.sentence
    if slip is not None:
        wheels(drive, 20_000)
        drive.run(100)
    drive.demanded = demanded
    drive.turn(2000)
    drive.run(2000)
    return drive


def sent(drive: Drive, controller: str = "PCU1"):
    return drive.result.commands[controller]


def heat(drive: Drive, celsius: int, *controllers: str) -> None:
    for name in controllers or CONTROLLERS:
        drive.codes[f"{name}_Status1.MotorTemperature"] = celsius


# Curves.


def test_a_hot_motor_lowers_the_power_of_both_along_the_slew():
    drive = driving(power_limit_w__by_motor_temperature_c=HOT)
    assert sent(drive).power_limit_w == 60_000
    heat(drive, 110, "PCU2")
    drive.run(500)
    falling_w = []
    for _ in range(30):
        drive.tick()
        assert sent(drive, "PCU1").power_limit_w == sent(drive, "PCU2").power_limit_w
        falling_w.append(sent(drive).power_limit_w)
    assert falling_w[-1] == 6000
    steps = [before - after for before, after in itertools.pairwise(falling_w)]
    assert max(steps) <= 3000
    assert "limited by motor temperature 110 °C: power at most 6.0 kW (for " in drive.sentence


def assert_it_returns_when_the_motors_cool(drive: Drive) -> None:
    heat(drive, 40)
    drive.run(500)
    before_w = sent(drive).power_limit_w
    drive.run(1000)
    assert sent(drive).power_limit_w == pytest.approx(before_w + 1000)


def test_a_limit_returns_at_its_own_rate_while_active():
    drive = driving(power_limit_w__by_motor_temperature_c=HOT)
    heat(drive, 110)
    drive.run(2000)
    assert_it_returns_when_the_motors_cool(drive)


def test_a_limit_returns_beside_one_that_stays():
    drive = driving(
        power_limit_w__by_motor_temperature_c=HOT,
        power_limit_w__by_controller_temperature_c=HOT,
    )
    heat(drive, 110)
    drive.run(2000)
    heat(drive, 40)
    drive.run(500)
    before_w = sent(drive).power_limit_w
    for celsius in (30, 40):
        drive.codes["PCU1_Status1.ControllerTemperature"] = celsius
        drive.run(500)
    assert sent(drive).power_limit_w == pytest.approx(before_w + 1000)


def test_a_limit_returns_beside_one_that_limits_all_the_time():
    drive = driving(
        power_limit_w__by_motor_temperature_c=HOT,
        power_limit_w__by_controller_temperature_c=HOT,
    )
    heat(drive, 110)
    drive.codes["PCU1_Status1.ControllerTemperature"] = 100
    drive.run(2000)
    assert_it_returns_when_the_motors_cool(drive)


PACKS = {
    "power_limit_w__by_pack_temperature_max_c": curve((45, 14_000), (60, 0)),
    "power_limit_w__by_pack_temperature_min_c": curve((-10, 3000), (5, 14_000)),
}


@pytest.mark.parametrize(
    ("first_c", "second_c", "caps_w"), [(60, 20, [0, 14_000]), (-10, 30, [14_000, 3000])]
)
def test_of_two_inputs_that_change_in_a_tick_the_one_that_limits_counts(first_c, second_c, caps_w):
    drive = driving(**PACKS)
    drive.codes["BMS_Temperatures.PackTemperature1"] = first_c + 50
    drive.codes["BMS_Temperatures.PackTemperature2"] = second_c + 50
    drive.receive("BMS_Temperatures", drive.now_ns + 1 * MS)
    drive.tick()
    assert [one.cap for one in drive.gateway.curves] == caps_w


def test_an_input_is_told_anew_where_the_limit_stays():
    drive = driving(power_limit_w__by_motor_temperature_c=HOT)
    for celsius in (130, 135):
        heat(drive, celsius)
        drive.run(2000)
        assert f"motor temperature {celsius} °C: power at most 0.0 kW" in drive.sentence


def test_outside_active_a_limit_is_what_its_curve_says():
    drive = driving(power_limit_w__by_motor_temperature_c=HOT)
    heat(drive, 110)
    drive.run(2000)
    drive.gateway.requests.disarm(drive.now_ns)
    heat(drive, 40)
    drive.run(600)
    assert drive.gateway._laws.deratings.held == {"power_limit_w.by_motor_temperature_c": 60_000}


def test_an_input_that_is_not_known_falls_to_the_derated_power_and_never_rises():
    drive = driving(power_limit_w__by_motor_temperature_c=HOT)
    drive.silent.add("PCU1_Status1")
    drive.run(4000)
    assert sent(drive).power_limit_w <= 10_000
    told = [str(held.finding) for held in drive.gateway.causes.held]
    assert "motor temperature not known: power at most 10.0 kW" in told


def test_an_input_that_is_not_known_is_told_though_the_derated_value_is_as_high_as_the_curve():
    settings = {"derated_power_w": 60_000}
    drive = driving(power_limit_w__by_motor_temperature_c=HOT, settings=settings)
    drive.silent.add("PCU1_Status1")
    drive.run(4000)
    told = [str(held.finding) for held in drive.gateway.causes.held]
    assert "motor temperature not known: power at most 60.0 kW" in told


def test_a_state_of_charge_that_is_not_known_does_not_limit_the_speed():
    drive = driving(speed_limit_rpm__by_soc_pct=curve((5, 1700), (15, 12_000)))
    drive.codes["BMS_Status.SOC"] = 120  # out of range
    drive.run(3000)
    assert drive.gateway._commander.caps["PCU1"].speed_rpm == 12_000, "never more than it was"
    told = [str(held.finding) for held in drive.gateway.causes.held]
    assert "state of charge not known: speed at most 12000 rpm" in told


def test_a_curve_that_never_knew_its_input_is_told_as_no_limit():
    drive = driving()
    drive.codes["BMS_Status.SOC"] = 120
    drive.run(1000)
    settings = drive.gateway.settings
    curves = {"speed_limit_rpm.by_soc_pct": curve((5, 1700), (15, 12_000))}
    tuning = dataclasses.replace(settings.tuning, curves=curves)
    assert drive.gateway.reload(dataclasses.replace(settings, tuning=tuning)).granted
    drive.tick()
    told = [str(held.finding) for held in drive.gateway.causes.held]
    assert "state of charge not known: speed not limited" in told


@pytest.mark.parametrize(
    ("name", "code", "worst", "good", "field", "per_s"),
    [
        ("power_limit_w__by_soc_pct", "BMS_Status.SOC", 3, 80, "power_w", 700.0),
        ("brake_pct__by_soc_pct", "BMS_Status.SOC", 98, 50, "brake_pct", 30.0),
        ("speed_limit_rpm__by_soc_pct", "BMS_Status.SOC", 5, 80, "speed_rpm", 1500.0),
    ],
)
def test_in_active_a_limit_returns_at_its_own_rate(name, code, worst, good, field, per_s):
    rates = {
        "power_return_w_per_s": 700.0,
        "brake_return_pct_per_s": 30.0,
        "speed_return_rpm_per_s": 1500.0,
    }
    drive = driving(settings=rates, **{name: EXAMPLES[name.replace("__", ".")]})
    drive.codes[code] = worst
    drive.run(1000)
    lowest = getattr(drive.gateway._commander.caps["PCU1"], field)
    drive.codes[code] = good
    drive.run(500)
    before = getattr(drive.gateway._commander.caps["PCU1"], field)
    drive.run(1000)
    after = getattr(drive.gateway._commander.caps["PCU1"], field)
    assert lowest <= before
    assert after - before == pytest.approx(per_s)


def test_what_is_on_its_way_back_goes_on_after_a_reload():
    drive = driving(modes={"eco": ECO, "sport": SPORT}, power_limit_w__by_motor_temperature_c=HOT)
    heat(drive, 125)
    drive.run(1000)
    heat(drive, 40)
    drive.run(600)
    before = dict(drive.gateway._laws.deratings.held)
    settings = drive.gateway.settings
    stricter = {
        **settings.tuning.curves,
        "power_limit_w.by_soc_pct": EXAMPLES["power_limit_w.by_soc_pct"],
    }
    tuning = dataclasses.replace(settings.tuning, curves=stricter)
    assert drive.gateway.reload(dataclasses.replace(settings, tuning=tuning)).granted
    assert drive.gateway.mode is Mode.ACTIVE
    drive.tick()
    after = drive.gateway._laws.deratings.held
    motor = "power_limit_w.by_motor_temperature_c"
    assert after[motor] == pytest.approx(before[motor] + 50)


def test_a_drive_modes_limit_on_its_way_back_goes_on_after_a_reload():
    drive = driving(modes={"eco": ECO, "sport": SPORT}, demanded=ControllerDemand())
    ask(drive, "sport")
    drive.run(100)
    before_w = drive.gateway._laws.deratings.held["drive_modes.power_limit_w"]
    settings = drive.gateway.settings
    tuning = dataclasses.replace(
        settings.tuning, curves={"power_limit_w.by_motor_temperature_c": HOT}
    )
    assert drive.gateway.reload(dataclasses.replace(settings, tuning=tuning)).granted
    drive.tick()
    after_w = drive.gateway._laws.deratings.held["drive_modes.power_limit_w"]
    assert 8000 < before_w < after_w == pytest.approx(before_w + 50)


def test_a_curve_that_limits_is_told_from_standby_on():
    drive = Drive(tuning=Tuning(curves={"power_limit_w.by_motor_temperature_c": HOT}))
    heat(drive, 110)
    drive.until(Mode.STANDBY).tick()
    told = [held.finding for held in drive.gateway.causes.held if held.finding.effect is Effect.CAP]
    assert [one.detail for one in told] == ["110 °C: power at most 6.0 kW"]


def test_a_curve_that_a_reload_takes_away_limits_no_more():
    drive = driving(modes=MODES, power_limit_w__by_motor_temperature_c=HOT)
    heat(drive, 125)
    drive.run(2000)
    drive.gateway.requests.disarm(drive.now_ns)
    settings = drive.gateway.settings
    without = dataclasses.replace(settings.tuning, curves={})
    assert drive.gateway.reload(dataclasses.replace(settings, tuning=without)).granted
    drive.tick()
    assert drive.gateway._commander.caps["PCU1"].power_w == 8000, "that of the drive mode"
    assert drive.gateway.curves == ()


def test_a_limit_below_the_derated_power_stays_where_its_input_is_lost():
    drive = driving(power_limit_w__by_motor_temperature_c=HOT)
    heat(drive, 110)
    drive.run(2000)
    drive.silent.add("PCU1_Status1")
    drive.run(4000)
    assert sent(drive).power_limit_w == 6000


@pytest.mark.parametrize(
    ("name", "silent", "field", "fallback"),
    [
        ("power_limit_w__by_pack_temperature_max_c", "BMS_Temperatures", "power_limit_w", 10_000),
        ("power_limit_w__by_battery_voltage_v", "", "power_limit_w", 1000),
        ("brake_pct__by_pack_temperature_max_c", "BMS_Temperatures", "brake_pct", 20),
    ],
)
def test_without_its_input_the_fallback_counts(name, silent, field, fallback):
    demanded = BRAKING if field == "brake_pct" else FULL
    drive = driving(demanded, **{name: EXAMPLES[name.replace("__", ".")]})
    drive.silent.add(silent)
    drive.run(6000)
    assert getattr(sent(drive), field) == fallback


def test_a_motor_speed_out_of_range_is_not_known_and_the_brake_falls_to_its_derated_value():
    drive = driving(brake_pct__by_motor_speed_rpm=EXAMPLES["brake_pct.by_motor_speed_rpm"])
    drive.codes["PCU1_Status2.MotorSpeed"] = 6001  # out of range
    drive.run(3000)
    assert "motor speed not known: brake at most 20 %" in drive.sentence


def signals_of(derating):
    return [(message, one) for message, signals in derating.input.messages for one in signals]


def set_to(drive: Drive, message: str, signal: str, value: float) -> None:
    """Have every frame of the message carry this physical value from now on."""
    specs = {one.name: one for one in drive.gateway.snapshot(drive.now_ns).messages}
    spec = specs[message].signal(signal)
    drive.codes[f"{message}.{signal}"] = round((value - spec.offset) / spec.factor)


@pytest.mark.parametrize("name", DERATINGS)
def test_of_the_signals_of_an_input_the_worst_counts(name):
    derating, one = DERATINGS[name], EXAMPLES[name]
    drive = driving(**{name.replace(".", "__"): one})
    worst, good = one.points[0][0], one.points[-1][0]
    if not derating.rises:
        worst, good = good, worst
    signals = signals_of(derating)
    for bad in signals:
        for one_signal in signals:
            message, signal = one_signal
            set_to(drive, message, signal, worst if one_signal == bad else good)
        drive.run(2000)
        assert drive.gateway.curves[0].x == pytest.approx(worst, abs=0.01), bad


@pytest.mark.parametrize("name", DERATINGS)
def test_each_curve_gives_its_lowest_value_at_its_worst_input(name):
    derating, one = DERATINGS[name], EXAMPLES[name]
    demanded = BRAKING if derating.limit == "brake_pct" else FULL
    drive = driving(demanded, **{name.replace(".", "__"): one})
    worst = one.points[0][0] if derating.rises else one.points[-1][0]
    for message, signal in signals_of(derating):
        set_to(drive, message, signal, worst)
    drive.run(30_000)
    field = {"power_limit_w": "power_limit_w", "brake_pct": "brake_pct"}.get(
        derating.limit, "speed_limit_rpm"
    )
    assert getattr(sent(drive), field) == pytest.approx(one.lowest, abs=20)
    held = {one.finding.cause for one in drive.gateway.causes.held}
    assert derating.key in held


@pytest.mark.parametrize("stamped", [[(125, 1), (40, 2)], [(40, 2), (125, 1)]], ids=str)
def test_of_several_frames_between_two_ticks_the_worst_counts(stamped):
    drive = driving(power_limit_w__by_motor_temperature_c=HOT)
    for celsius, at_ms in stamped:
        heat(drive, celsius)
        drive.receive("PCU1_Status1", drive.now_ns + at_ms * MS)
    heat(drive, 40)
    drive.tick()
    (curve,) = drive.gateway.curves
    assert (curve.x, curve.cap) == (125.0, 0.0)
    drive.tick()
    (curve,) = drive.gateway.curves
    assert curve.x == 40.0, "of the tick after them only the latest"


def test_several_frames_count_in_each_of_several_ticks():
    drive = driving(power_limit_w__by_pack_temperature_max_c=curve((45, 14_000), (60, 0)))
    for worst_c in (50, 55):
        for celsius, at_ms in ((worst_c, 1), (30, 2)):
            drive.codes["BMS_Temperatures.PackTemperature1"] = celsius + 50
            drive.receive("BMS_Temperatures", drive.now_ns + at_ms * MS)
        drive.tick()
        assert drive.gateway.curves[0].x == worst_c


def test_a_frame_older_than_the_latest_counts_in_its_tick_alone():
    drive = driving(power_limit_w__by_pack_temperature_max_c=curve((45, 14_000), (60, 0)))
    usual_c = drive.gateway.curves[0].x
    drive.receive("BMS_Temperatures", drive.now_ns + 1 * MS)
    drive.tick()
    drive.codes["BMS_Temperatures.PackTemperature1"] = 105
    drive.receive("BMS_Temperatures", drive.now_ns - 51 * MS)
    del drive.codes["BMS_Temperatures.PackTemperature1"]
    drive.tick()
    assert drive.gateway.curves[0].x == 55
    drive.tick()
    assert drive.gateway.curves[0].x == usual_c


def test_a_power_limit_of_0_by_a_curve_takes_the_throttle_too():
    drive = driving(power_limit_w__by_motor_temperature_c=HOT)
    heat(drive, 125)
    drive.run(500)
    while sent(drive).power_limit_w > 0:
        assert sent(drive).throttle_pct > 0
        drive.tick()
    assert sent(drive).throttle_pct == 0


def test_a_brake_of_0_by_a_curve_takes_the_regeneration_too():
    demanded = dataclasses.replace(BRAKING, regen_brake=True)
    drive = driving(demanded, brake_pct__by_soc_pct=EXAMPLES["brake_pct.by_soc_pct"])
    assert sent(drive).regen_brake
    drive.codes["BMS_Status.SOC"] = 98
    drive.run(500)
    while sent(drive).brake_pct > 0:
        assert sent(drive).regen_brake
        drive.tick()
    assert not sent(drive).regen_brake


@pytest.mark.parametrize(("power_w", "brake_pct"), [(0.0, 0.0), (0.5, 0.195)])
def test_a_limit_that_the_frame_rounds_to_0_is_0(power_w, brake_pct):
    drive = driving(power_limit_w__by_motor_temperature_c=curve((95, power_w), (110, power_w)))
    assert drive.result.frames[0].data[6:8] == b"\0\0"
    assert sent(drive).throttle_pct == 0
    demanded = dataclasses.replace(BRAKING, regen_brake=True)
    drive = driving(demanded, brake_pct__by_soc_pct=curve((0, brake_pct), (100, brake_pct)))
    assert drive.result.frames[0].data[2] == 0
    assert not sent(drive).regen_brake


@pytest.mark.parametrize("level", ["CellUndervoltage", "CellOvervoltage"])
def test_beside_a_curve_that_leaves_all_a_limit_of_0_by_a_cause_is_as_without_it(level):
    settings = {"derated_power_w": 0, "regen_limit_pct": 0}
    demanded = dataclasses.replace(FULL, brake_pct=3, regen_brake=True)
    curves = {
        "power_limit_w__by_motor_temperature_c": HOT,
        "brake_pct__by_soc_pct": curve((90, 100), (98, 0)),
    }
    frames = []
    for some in ({}, curves):
        drive = driving(demanded, settings=settings, **some)
        drive.codes[f"BMS_Status.{level}"] = 1
        drive.run(4000)
        frames.append(drive.result.frames[0].data)
    assert frames[0] == frames[1]


def test_below_the_least_speed_nothing_regenerates_beside_a_curve():
    demanded = dataclasses.replace(BRAKING, regen_brake=True)
    drive = driving(demanded, brake_pct__by_soc_pct=EXAMPLES["brake_pct.by_soc_pct"])
    drive.turn(0)
    drive.run(500)
    assert not sent(drive).regen_brake
    assert drive.gateway.mode is Mode.ACTIVE, "and not because the gate blocked it"


def test_the_smallest_limits_that_are_not_0_take_nothing_else():
    drive = driving(power_limit_w__by_motor_temperature_c=curve((95, 1), (110, 1)))
    assert (sent(drive).power_limit_w, sent(drive).throttle_pct) == (1, 100)
    demanded = dataclasses.replace(BRAKING, regen_brake=True)
    drive = driving(demanded, brake_pct__by_soc_pct=curve((0, 1), (100, 1)))
    assert (sent(drive).brake_pct, sent(drive).regen_brake) == (1, True)


def test_motors_whose_temperatures_differ_by_more_than_40_degrees_are_told():
    drive = driving(power_limit_w__by_motor_temperature_c=HOT)
    heat(drive, 80, "PCU1")
    drive.run(600)
    assert "motor_temperature_difference" not in {
        c.finding.cause for c in drive.gateway.causes.held
    }
    heat(drive, 81, "PCU1")
    drive.run(600)
    (held,) = drive.gateway.causes.held
    assert str(held.finding) == "motor temperatures differ by 41 °C: alarm"


def test_a_speed_limit_by_a_curve_falls_slowly_and_returns_slowly():
    limit = EXAMPLES["speed_limit_rpm.by_soc_pct"]
    drive = driving(speed_limit_rpm__by_soc_pct=limit)
    drive.codes["BMS_Status.SOC"] = 14
    drive.run(500)
    before_rpm = sent(drive).speed_limit_rpm
    drive.run(1000)
    assert sent(drive).speed_limit_rpm == pytest.approx(before_rpm - 500)
    drive.codes["BMS_Status.SOC"] = 80
    drive.run(10_000)
    assert sent(drive).speed_limit_rpm == 12_000


# Drive modes.

ECO = DriveMode(
    by_pedal=curve((0, 0), (50, 10), (100, 60)),
    power_mode_max=PowerMode.NORMAL,
    power_limit_w=8000,
    speed_limit_kmh=40,
)
SPORT = DriveMode()
VALET = DriveMode(speed_limit_kmh=15, left_by_service=True)
MODES = {"eco": ECO, "sport": SPORT, "valet": VALET}


def test_the_mode_of_a_start_caps_what_it_says():
    drive = driving(modes=MODES)
    command = sent(drive)
    assert command.throttle_pct == 60
    assert command.power_mode is PowerMode.NORMAL
    assert (command.power_limit_w, command.speed_limit_rpm) == (8000, 4000)


def ask(drive: Drive, mode: str, level=FaultClass.DRIVER):
    return drive.gateway.apply(calls.SetDriveMode(mode, level, drive.now_ns))


def test_a_mode_asked_for_at_full_pedal_waits_for_the_release():
    drive = driving(modes=MODES)
    assert ask(drive, "sport").granted
    drive.run(2000)
    assert sent(drive).throttle_pct == 60
    assert sent(drive).power_limit_w == 8000
    assert "drive mode sport waits for the pedal's release" in drive.sentence
    drive.demanded = dataclasses.replace(FULL, throttle_pct=5.0)
    drive.tick()
    assert drive.gateway.drive_modes == ("eco", "sport"), "5 % is not released"
    drive.demanded = dataclasses.replace(FULL, throttle_pct=4.9)
    drive.tick()
    assert drive.gateway.drive_modes == ("sport", "sport")
    assert [one.fields for one in drive.events if one.name == "drive_mode_changed"] == [
        {"mode": "sport"}
    ]


def test_outside_active_a_mode_asked_for_counts_though_the_pedal_is_pressed():
    drive = standby(tuning=Tuning(start="eco", modes=MODES, motor_rpm_per_kmh=RPM_PER_KMH))
    drive.demanded = FULL
    ask(drive, "sport")
    drive.tick()
    assert drive.gateway.drive_modes == ("sport", "sport")


def test_a_mode_asked_for_waits_for_the_pedal_of_both_controllers():
    drive = driving(modes=MODES)
    ask(drive, "sport")
    released = dataclasses.replace(FULL, throttle_pct=0)
    drive.demanded = None
    drive.offer(FULL, controllers=dict(zip(CONTROLLERS, (FULL, released), strict=True)))
    drive.tick()
    assert drive.gateway.drive_modes == ("eco", "sport")


def test_a_mode_asked_for_is_taken_where_nothing_is_demanded_any_more():
    drive = driving(modes=MODES)
    ask(drive, "sport")
    drive.demanded = None
    drive.run(400)
    assert drive.gateway.drive_modes == ("sport", "sport")


def test_a_mode_counts_in_its_tick_though_nothing_else_has_changed():
    tame = DriveMode(power_mode_max=PowerMode.ECO)
    released = dataclasses.replace(FULL, throttle_pct=0)
    drive = driving(released, modes={"tame": tame, "sport": SPORT})
    assert sent(drive).power_mode is PowerMode.ECO
    ask(drive, "sport")
    drive.tick()
    assert sent(drive).power_mode is PowerMode.TURBO


def test_a_mode_that_a_reload_changed_counts_though_nothing_else_has_changed():
    released = dataclasses.replace(FULL, throttle_pct=0)
    drive = driving(released, modes={"tame": DriveMode(power_mode_max=PowerMode.NORMAL)})
    drive.gateway.requests.disarm(drive.now_ns)
    drive.tick()
    settings = drive.gateway.settings
    modes = {"tame": DriveMode(power_mode_max=PowerMode.ECO)}
    tuning = dataclasses.replace(settings.tuning, modes=modes)
    assert drive.gateway.reload(dataclasses.replace(settings, tuning=tuning)).granted
    assert drive.arm().granted
    drive.tick()
    assert sent(drive).power_mode is PowerMode.ECO


@pytest.mark.parametrize("mode", [ECO, DriveMode(by_speed=curve((0, 30), (60, 90)))])
def test_caps_are_found_anew_only_where_something_has_changed(mode):
    drive = driving(modes={"eco": mode})
    wheels(drive, 20_000)
    drive.run(200)
    before = drive.gateway._commander.caps
    drive.tick()
    assert drive.gateway._commander.caps is before


def test_the_limits_of_a_mode_asked_for_count_from_the_request_on():
    drive = driving(modes={"sport": SPORT, "eco": ECO})
    assert sent(drive).power_limit_w == 60_000
    ask(drive, "eco")
    drive.tick()
    assert sent(drive).power_limit_w == 57_000
    assert sent(drive).throttle_pct == 100
    assert sent(drive).power_mode is PowerMode.TURBO


def test_a_mode_that_there_is_not_is_refused_with_those_that_there_are():
    answer = ask(driving(modes=MODES), "sprot")
    assert answer.refusal is Refusal.NO_SUCH_MODE
    assert answer.sentence == "there is no drive mode sprot; the modes are eco, sport, valet"


def test_without_modes_every_mode_is_refused():
    assert ask(driving(), "eco").sentence == "there is no drive mode eco; none is configured"


def test_a_mode_left_by_service_is_left_at_service_level_alone():
    drive = driving(modes={"valet": VALET, "sport": SPORT})
    answer = ask(drive, "sport")
    assert (answer.granted, answer.sentence) == (False, "drive mode valet is left at service level")
    assert ask(drive, "valet").granted
    assert ask(drive, "sport", FaultClass.SERVICE).granted


def test_a_gateway_begins_in_the_mode_that_the_process_before_it_kept():
    drive = Drive(tuning=Tuning(start="eco", modes=MODES, motor_rpm_per_kmh=RPM_PER_KMH))
    drive.gateway.apply(calls.BeginInMode("valet"))
    assert drive.gateway.drive_modes == ("valet", "valet")
    drive.gateway.apply(calls.BeginInMode("gone"))
    assert drive.gateway.drive_modes == ("valet", "valet")


def test_arming_waits_until_the_speed_limit_has_come_down():
    drive = Drive(tuning=Tuning(start="valet", modes=MODES, motor_rpm_per_kmh=RPM_PER_KMH))
    drive.until(Mode.STANDBY).run(1500)
    assert drive.gateway.requests.arm(drive.now_ns).sentence == (
        "the speed limit has not come down to its cap"
    )
    drive.run(3000)
    assert drive.gateway.requests.arm(drive.now_ns).granted


@pytest.mark.parametrize(("turning_rpm", "fall_rpm_per_s"), [(0, 4000), (1499, 4000), (1500, 500)])
def test_in_standby_a_speed_limit_comes_down_slowly_where_the_motors_turn_faster_than_it(
    turning_rpm, fall_rpm_per_s
):
    drive = standby(tuning=Tuning(start="sport", modes=MODES, motor_rpm_per_kmh=RPM_PER_KMH))
    drive.turn(turning_rpm)
    drive.run(200)
    ask(drive, "valet")
    before_rpm = sent(drive).speed_limit_rpm
    drive.tick()
    assert before_rpm - sent(drive).speed_limit_rpm == fall_rpm_per_s / 20


def test_arming_waits_for_the_speed_limit_of_a_mode_asked_for_in_the_same_instant():
    drive = standby(tuning=Tuning(start="sport", modes=MODES, motor_rpm_per_kmh=RPM_PER_KMH))
    assert drive.gateway.requests.against_arming(drive.now_ns) == ""
    ask(drive, "valet")
    assert drive.gateway.requests.arm(drive.now_ns).sentence == (
        "the speed limit has not come down to its cap"
    )


def test_a_reload_that_drops_the_mode_in_use_is_refused():
    drive = driving(modes=MODES)
    settings = drive.gateway.settings
    fewer = dataclasses.replace(settings.tuning, modes={"sport": SPORT}, start="eco")
    drive.gateway.requests.disarm(drive.now_ns)
    answer = drive.gateway.reload(dataclasses.replace(settings, tuning=fewer))
    assert answer.sentence == "drive mode eco is in use"


def wheels(drive: Drive, left: int, right: int | None = None) -> None:
    drive.codes["ARD2_SteeringWheel.WheelSpeedFL"] = left
    drive.codes["ARD2_SteeringWheel.WheelSpeedFR"] = left if right is None else right


def test_the_throttle_over_speed_follows_the_faster_front_wheel():
    drive = driving(modes={"rain": DriveMode(by_speed=curve((0, 30), (30, 60), (60, 100)))})
    assert sent(drive).throttle_pct == 30
    wheels(drive, 10_000, 30_000)
    drive.run(1000)
    assert sent(drive).throttle_pct == pytest.approx(60)
    wheels(drive, 65_535)
    drive.run(2000)
    assert sent(drive).throttle_pct == 100


@pytest.mark.parametrize("marked", ["WheelSpeedFL", "WheelSpeedFR"])
def test_a_single_saturated_wheel_is_the_faster_one(marked):
    drive = driving(modes={"rain": DriveMode(by_speed=curve((0, 30), (65, 95)))})
    drive.codes[f"ARD2_SteeringWheel.{marked}"] = 65_535
    drive.run(2000)
    assert sent(drive).throttle_pct == 95


@pytest.mark.parametrize("codes", [(30_000, 60_000), (60_000, 30_000)], ids=str)
def test_of_several_speeds_between_two_ticks_the_lowest_counts(codes):
    drive = driving(modes={"rain": DriveMode(by_speed=curve((0, 30), (60, 90)))})
    wheels(drive, 60_000)
    drive.run(2000)
    assert sent(drive).throttle_pct == 90
    for at_ms, code in enumerate(codes, 1):
        wheels(drive, code)
        drive.receive("ARD2_SteeringWheel", drive.now_ns + at_ms * MS)
    drive.tick()
    assert sent(drive).throttle_pct == 60


def test_without_a_speed_the_throttle_over_speed_goes_to_its_lowest():
    drive = driving(modes={"rain": DriveMode(by_speed=curve((0, 30), (60, 100)))})
    wheels(drive, 60_000)
    drive.run(2000)
    drive.silent.add("ARD2_SteeringWheel")
    drive.run(300)
    assert sent(drive).throttle_pct == 100
    for _ in range(14):
        before_pct = sent(drive).throttle_pct
        drive.tick()
        assert before_pct - 5.001 <= sent(drive).throttle_pct <= before_pct
    drive.run(500)
    assert sent(drive).throttle_pct == 30


@pytest.mark.parametrize(("kmh", "rise_pct"), [(0, 20), (20, 40)])
def test_the_throttle_rises_as_the_mode_says(kmh, rise_pct):
    drive = driving(
        modes={"rain": DriveMode(rise_by_speed=curve((0, 20), (40, 60)))},
        demanded=ControllerDemand(power_mode=PowerMode.TURBO),
    )
    wheels(drive, kmh * 1000)
    drive.run(1000)
    drive.demanded = FULL
    drive.run(1000)
    assert sent(drive).throttle_pct == pytest.approx(rise_pct)


@pytest.mark.parametrize(
    "rain",
    [
        DriveMode(by_speed=curve((0, 30), (60, 90))),
        DriveMode(rise_by_speed=curve((0, 20), (40, 60))),
    ],
    ids=["most", "rise"],
)
def test_a_mode_without_a_curve_over_speed_has_none_of_the_mode_before(rain):
    drive = driving(modes={"rain": rain, "dry": DriveMode()})
    drive.run(1000)
    drive.demanded = dataclasses.replace(FULL, throttle_pct=0)
    ask(drive, "dry")
    drive.run(200)
    drive.demanded = FULL
    drive.run(1100)
    assert sent(drive).throttle_pct == 100


# Slip.

SLIP = SlipLimiter()


def spin(drive: Drive, *motors_kmh: float, front_kmh: float = 20) -> None:
    wheels(drive, round(front_kmh * 1000))
    drive.turn(*(round(kmh * RPM_PER_KMH) for kmh in motors_kmh))


def slipping(**changes) -> Drive:
    drive = driving(slip=dataclasses.replace(SLIP, **changes))
    spin(drive, 20, 20)
    drive.run(1000)
    assert sent(drive).throttle_pct == 100
    return drive


def test_a_wheel_within_what_is_allowed_is_left_alone():
    drive = slipping()
    spin(drive, 28, 28)
    drive.run(1000)
    assert sent(drive).throttle_pct == 100


def test_a_wheel_beyond_what_is_allowed_is_cut_by_half_at_once_and_the_other_follows():
    drive = slipping()
    spin(drive, 28.01, 20)
    drive.tick()
    drive.tick()
    assert sent(drive, "PCU1").throttle_pct == 50
    assert sent(drive, "PCU2").throttle_pct == 70
    assert "limited by slip of PCU1: throttle at most 50 %" in drive.sentence


def test_a_cut_is_a_share_of_the_throttle_that_was_sent():
    drive = slipping()
    drive.demanded = dataclasses.replace(FULL, throttle_pct=40)
    drive.run(1000)
    spin(drive, 38, 38)
    drive.run(100)
    assert sent(drive).throttle_pct == pytest.approx(20, abs=0.2)


def test_the_next_cut_waits_and_the_lowest_throttle_stays():
    drive = slipping()
    spin(drive, 38, 38)
    throttles = []
    for _ in range(40):
        drive.tick()
        throttles.append(sent(drive).throttle_pct)
    changes = [i for i in range(1, 40) if throttles[i] != throttles[i - 1]]
    assert {after - before for before, after in itertools.pairwise(changes)} == {5}
    assert throttles[-1] == 10


def test_without_slip_the_throttle_returns_at_its_rate():
    drive = slipping()
    spin(drive, 38, 38)
    drive.run(150)
    spin(drive, 20, 20)
    drive.run(100)
    before_pct = sent(drive).throttle_pct
    drive.run(1000)
    assert sent(drive).throttle_pct == pytest.approx(before_pct + 10)


@pytest.mark.parametrize("codes", [(65_535, 65_535), (65_535, 60_000), (60_000, 65_535)])
def test_a_saturated_front_wheel_only_releases(codes):
    drive = driving(slip=SLIP, rpm_per_kmh=50.0)
    assert sent(drive).throttle_pct < 100
    wheels(drive, *codes)
    drive.turn(4500)  # 90 km/h, more than is allowed at 65.535
    drive.run(15_000)
    assert sent(drive).throttle_pct == 100


def test_without_a_front_speed_the_cap_stays_until_the_pedal_is_released():
    drive = slipping()
    spin(drive, 38, 38)
    drive.run(150)
    drive.silent.add("ARD2_SteeringWheel")
    drive.run(400)
    stays_pct = sent(drive).throttle_pct
    drive.run(1000)
    assert sent(drive).throttle_pct == stays_pct < 100
    drive.demanded = ControllerDemand(power_mode=PowerMode.TURBO)
    drive.run(10_000)
    drive.demanded = FULL
    drive.run(2000)
    assert sent(drive).throttle_pct == 100


def test_outside_active_it_forgets():
    drive = slipping()
    spin(drive, 38, 38)
    drive.run(500)
    drive.gateway.requests.disarm(drive.now_ns)
    drive.tick()
    assert drive.gateway._laws.slip.caps_pct == dict.fromkeys(CONTROLLERS, 100.0)


def test_a_wheel_whose_cap_has_returned_is_not_told_though_the_other_one_is():
    drive = slipping(asymmetry_max_pct=30)
    spin(drive, 38, 20)
    drive.run(100)
    spin(drive, 20, 20)
    drive.run(3500)
    caps_pct = drive.gateway._laws.slip.caps_pct
    assert caps_pct["PCU2"] == 100 > caps_pct["PCU1"]
    told = [
        held.finding.subject for held in drive.gateway.causes.held if held.absent_since_ns is None
    ]
    assert told == ["slip of PCU1"]


def test_a_drive_mode_with_a_pedal_map_needs_no_demand_in_standby():
    drive = standby(tuning=Tuning(start="eco", modes=MODES, motor_rpm_per_kmh=RPM_PER_KMH))
    drive.demanded = None
    drive.run(1000)
    assert drive.gateway.mode is Mode.STANDBY
    assert drive.gateway._commander.caps["PCU1"].power_w == 8000


# Together.


def test_nothing_is_told_before_standby():
    drive = Drive(tuning=Tuning(curves={"power_limit_w.by_motor_temperature_c": HOT}))
    drive.silent.add("PCU1_Status1")
    drive.run(500)
    assert not [held for held in drive.gateway.causes.held if held.finding.effect is Effect.CAP]


def test_laws_are_equal_where_they_remember_the_same():
    """A recording leaves them out where they are as at the start."""
    fresh = Laws(Tuning())
    assert fresh == Laws(Tuning())
    assert (fresh == "laws") is False
    for change in (
        lambda one: one.deratings.held.update({"brake_pct.by_soc_pct": 20.0}),
        lambda one: setattr(one.modes, "requested", "eco"),
        lambda one: one.slip.cut_ns.update({"PCU1": 1}),
    ):
        other = Laws(Tuning())
        change(other)
        assert other != fresh


def test_without_any_key_there_are_no_laws_and_a_reload_may_add_a_stricter_curve_alone():
    drive = driving()
    settings = drive.gateway.settings
    hot = Tuning(
        curves={"power_limit_w.by_motor_temperature_c": HOT}, motor_rpm_per_kmh=RPM_PER_KMH
    )
    assert drive.gateway.reload(dataclasses.replace(settings, tuning=hot)).granted
    looser = dataclasses.replace(
        hot,
        curves={"power_limit_w.by_motor_temperature_c": curve((95, 60000), (110, 7000), (125, 0))},
    )
    answer = drive.gateway.reload(dataclasses.replace(settings, tuning=looser))
    assert answer.sentence == (
        "while active, limits may only become stricter: curves.power_limit_w.by_motor_temperature_c"
    )
    assert not drive.gateway.reload(settings).granted
    drive.gateway.requests.disarm(drive.now_ns)
    assert drive.gateway.reload(settings).granted
    assert drive.gateway._commander.caps == Drive().gateway._commander.caps


def test_the_start_mode_needs_a_restart():
    drive = driving(modes=MODES)
    settings = drive.gateway.settings
    other = dataclasses.replace(settings.tuning, start="sport")
    answer = drive.gateway.reload(dataclasses.replace(settings, tuning=other))
    assert answer.sentence == "these need a restart: drive_modes.start"
    assert Settings().tuning == Tuning()


def test_a_curve_that_a_reload_took_away_begins_anew():
    drive = driving(power_limit_w__by_motor_temperature_c=HOT)
    heat(drive, 110)
    drive.run(2000)
    drive.gateway.requests.disarm(drive.now_ns)
    settings = drive.gateway.settings
    other = Tuning(curves={"brake_pct.by_soc_pct": EXAMPLES["brake_pct.by_soc_pct"]})
    assert drive.gateway.reload(dataclasses.replace(settings, tuning=other)).granted
    drive.tick()
    assert drive.gateway._laws.deratings.held == {"brake_pct.by_soc_pct": 100.0}


def test_laws_that_remember_the_same_are_equal():
    tuning = Tuning(start="eco", modes=MODES)
    assert Laws(tuning) == Laws(tuning)
    assert Laws(tuning) != Laws(Tuning())
    assert Laws(tuning) != 5


def test_curves_and_slip_are_told_to_whoever_asks():
    drive = driving(power_limit_w__by_motor_temperature_c=HOT, slip=SLIP)
    heat(drive, 110)
    drive.run(2000)
    assert drive.gateway.curves == (
        CurveState("power_limit_w.by_motor_temperature_c", 110.0, 6000.0),
    )
    assert drive.gateway.slip_caps_pct == dict.fromkeys(CONTROLLERS, 100.0)


def test_another_one_s_state_whose_mode_is_not_configured_begins_in_the_start_mode():
    drive = driving(modes=MODES)
    other = dataclasses.replace(
        drive.gateway.settings.tuning, modes={"sport": SPORT}, start="sport"
    )
    drive.gateway.settings = dataclasses.replace(drive.gateway.settings, tuning=other)
    drive.gateway.fit_laws()
    assert drive.gateway.drive_modes == ("sport", "sport")
