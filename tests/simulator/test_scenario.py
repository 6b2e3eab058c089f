"""What each ready scenario promises, kept by the pure core; and bad scenarios refused."""

import itertools
import random
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tests.simulator.driving import CRUISE, S_NS, START_NS, Asked, Drive, Ticked, drive, signals
from vcu_gateway.cli.simulate import simulate
from vcu_gateway.core.codec import Codec, Reason
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.errors import ConfigError
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.simulator.scenario import FAULTS, Scenario, load, parse

ROOT = Path(__file__).parents[2]
READY = ROOT / "config/scenarios"
CODEC = Codec(dbc.load(packaged("vcu.dbc")))
ZERO_TORQUE = bytes.fromhex("0c000000e02e0000")
POWER_CUT = bytes.fromhex("8c000000e02e0000")
TICK_S = 0.05
NAMES = ", ".join(FAULTS)
CHECKED = set(re.findall(r'ready\("([a-z0-9-]+)"', Path(__file__).read_text()))


def ready(name: str, seconds: float, asked: Asked = CRUISE, **settings: Any) -> Drive:
    """A drive with a ready scenario, all of which break at 10 s; it drives until then."""
    scenario = load(READY / f"{name}.yaml", CODEC.protocol)
    done = drive(CODEC, scenario, seconds, asked, **settings)
    assert done.tick_at(9.99).mode is Mode.ACTIVE, done.tick_at(9.99).why.sentence()
    return done


def cause_s(done: Drive, message: str, signal: str, raw: int) -> float:
    """When the first frame came in which the signal has this code."""
    codec = CODEC.by_name[message]
    index = codec.spec.signal_names.index(signal)
    heard = done.heard_of(message)
    return next(at for at, frame in heard if codec.decode(frame.data).raws[index] == raw)


def assert_latched(done: Drive, since_s: float, bound_s: float, reason: str) -> None:
    """ZERO_TORQUE to both within the bound and one tick, for the driver to reset, and so on."""
    fault = done.first(Mode.FAULT)
    assert fault.at_s - since_s <= bound_s + TICK_S
    assert fault.at_s - since_s > bound_s - 1e-9, "not before its time"
    assert fault.why.latch.fault_class is FaultClass.DRIVER
    assert reason in fault.why.latch.reason
    after = [tick for tick in done.ticks if tick.at_s >= fault.at_s]
    assert {tick.mode for tick in after} == {Mode.FAULT}
    assert {tick.frames for tick in after} == {(ZERO_TORQUE, ZERO_TORQUE)}


def test_every_ready_scenario_is_checked_here():
    assert {path.stem for path in READY.glob("*.yaml")} == CHECKED


def test_undervoltage_2_stops_within_one_tick_and_stays_latched():
    done = ready("undervoltage2", 15)
    at_s = cause_s(done, "BMS_Status", "CellUndervoltage", 2)
    assert_latched(done, at_s, 0, "BMS_Status.CellUndervoltage 2")


def test_the_undervoltage_ladder_limits_then_stops_then_cuts():
    done = ready("undervoltage-ladder", 18)
    first_s, second_s, third_s = (
        cause_s(done, "BMS_Status", "CellUndervoltage", level) for level in (1, 2, 3)
    )
    limited = done.tick_at(first_s + TICK_S)
    for data in limited.frames:
        assert signals(CODEC, data)["PowerMode"] == PowerMode.ECO
        assert signals(CODEC, data)["PowerLimit"] == 57_000, "60000 W/s in a tick of 50 ms"
    derated = done.tick_at(second_s - TICK_S)
    assert derated.mode is Mode.ACTIVE
    for data in derated.frames:
        assert signals(CODEC, data)["PowerLimit"] == 10_000
        assert signals(CODEC, data)["Throttle"] == pytest.approx(40, abs=0.2)
    stopped = done.tick_at(second_s + TICK_S)
    assert (stopped.mode, stopped.frames) == (Mode.FAULT, (ZERO_TORQUE, ZERO_TORQUE))
    assert stopped.why.latch.fault_class is FaultClass.DRIVER
    for tick in (done.tick_at(third_s + TICK_S), done.ticks[-1]):
        assert (tick.mode, tick.frames) == (Mode.FAULT, (POWER_CUT, POWER_CUT))
        assert tick.why.latch.fault_class is FaultClass.SERVICE


def test_overcharge_limits_regeneration_then_forbids_it_until_restart():
    braking = ControllerDemand(brake_pct=50, regen_brake=True)
    done = ready("overcharge", 22, braking, regen_min_rpm=0)

    def brakes(at_s: float) -> set[tuple[float, float]]:
        frames = [signals(CODEC, data) for data in done.tick_at(at_s).frames]
        return {(frame["RegenBrake"], round(frame["Brake"])) for frame in frames}

    first_s, second_s = (cause_s(done, "BMS_Status", "CellOvervoltage", n) for n in (1, 2))
    assert brakes(9.9) == {(1, 50)}
    assert brakes(first_s + TICK_S) == {(1, 45)}, "100 %/s in a tick of 50 ms"
    assert brakes(second_s - TICK_S) == {(1, 20)}
    assert brakes(second_s + TICK_S) == {(0, 0)}
    assert cause_s(done, "BMS_Status", "CellOvervoltage", 3) < 17
    assert brakes(22) == {(0, 0)}, "3 s after the battery said that all is well"
    assert {tick.mode for tick in done.ticks if tick.at_s > 10} == {Mode.ACTIVE}


def test_a_silent_battery_limits_then_stops():
    done = ready("bms-silent", 18)
    last_s = [at for at, _ in done.heard_of("BMS_Status") if at < 10][-1]
    assert not done.tick_at(last_s + 1.1).why.limits
    limited = done.tick_at(last_s + 1.1 + TICK_S)
    assert {signals(CODEC, data)["PowerMode"] for data in limited.frames} == {PowerMode.ECO}
    assert_latched(done, last_s, 1.6, "BMS_Status 16")


def test_a_frozen_life_signal_limits_at_the_second_frame_and_stops_at_the_third():
    done = ready("bms-frozen-life", 13)
    frozen_s = [at for at, _ in done.heard_of("BMS_Status", 10)]
    assert not done.tick_at(frozen_s[1] - 1e-6).why.limits
    limited = done.tick_at(frozen_s[1] + TICK_S)
    assert {signals(CODEC, data)["PowerMode"] for data in limited.frames} == {PowerMode.ECO}
    assert_latched(done, frozen_s[2], 0, "LifeSignal unchanged in 3 frames")


@pytest.mark.parametrize("controller", ["PCU1", "PCU2"])
def test_a_silent_controller_stops_both(controller: str):
    number = controller[-1]
    done = {"1": lambda: ready("pcu1-silent", 15), "2": lambda: ready("pcu2-silent", 15)}[number]()
    last_s = [at for at, _ in done.heard_of(f"{controller}_Status2") if at < 10][-1]
    assert_latched(done, last_s, 0.2, f"{controller}_Status2")


def test_a_silent_imu_is_an_alarm_and_no_more():
    done = ready("imu-silent", 15)
    assert {tick.mode for tick in done.ticks if tick.at_s > 10} == {Mode.ACTIVE}
    during = done.tick_at(12)
    assert {held.finding.subject for held in during.why.alarms} == {
        "IMU_Acceleration", "IMU_AngularRate", "IMU_Attitude",
    }  # fmt: skip
    assert during.frames == done.tick_at(9.9).frames
    assert not done.ticks[-1].why.alarms


def test_a_hot_controller_takes_turbo_from_both_and_then_stops_both():
    done = ready("hot-controller", 18)
    first_s, second_s = (
        cause_s(done, "PCU2_Status1", "TemperatureProtectLevel", level) for level in (1, 2)
    )
    modes = [
        [signals(CODEC, data)["PowerMode"] for data in done.tick_at(at_s).frames]
        for at_s in (9.9, first_s + TICK_S, second_s - TICK_S)
    ]
    assert modes == [[2, 2], [1, 1], [1, 1]]
    assert_latched(done, second_s, 0, "PCU2_Status1.TemperatureProtectLevel 2")


def test_a_controller_that_ignores_commands_is_found_by_its_echo():
    done = ready("ignoring-controller", 14)
    at_s = next(at for at, _ in done.heard_of("PCU1_Status1", 10))
    assert at_s < 10.5
    assert_latched(done, at_s, 0, "PCU1_Status1.Throttle 80")


CUT_AT_12_S = "  - {at_s: 12, fault: set, signal: BMS_Status.CellUndervoltage, raw: 3}\n"


@pytest.mark.parametrize(
    ("step", "sentence"),
    [
        (
            "{at_s: 10, fault: ignore_commands, controller: PCU1}",
            "NOT OBEYED: PCU1 reports PowerCut normal, throttle 40.2 %; use the contactor",
        ),
        ("{at_s: 10, fault: silence, of: PCU1_Status1}", "Stop sent; PCU1 does not confirm"),
        ("{at_s: 10, fault: silence, of: IMU}", "Power is cut: PCU1 and PCU2 confirm"),
    ],
    ids=["ignores commands", "sends no Status1", "obeys"],
)
def test_a_stop_that_a_controller_does_not_obey_or_confirm_is_told_as_such(step, sentence):
    scenario = parse(f"steps:\n  - {step}\n{CUT_AT_12_S}", "here", CODEC.protocol)
    done = drive(CODEC, scenario, 16, stale_after_ms={"PCU1_Status1": 10_000})
    stop = done.gateway.stop(START_NS + 16 * S_NS)
    assert stop is not None
    assert stop.sentence() == sentence


def test_a_foreign_sender_stops_both_at_its_first_frame():
    done = ready("foreign-sender", 15)
    at_s, frame = done.heard_of("VCU_PCU2_Command")[0]
    assert signals(CODEC, frame.data)["Throttle"] == pytest.approx(30, abs=0.2)
    assert_latched(done, at_s, 0, "0008A8D0")


def test_a_lossy_bus_ends_in_zero_torque_and_nothing_is_rejected():
    done = ready("lossy-bus", 40)
    fault = done.first(Mode.FAULT)
    assert fault.why.latch.fault_class is FaultClass.DRIVER
    assert "Status" in fault.why.latch.reason
    assert set(done.ticks[-1].frames) == {ZERO_TORQUE}
    assert not any(done.gateway.receiver.rejected.values())


def test_a_corrupt_bus_ends_in_zero_torque_and_every_short_frame_is_counted():
    done = ready("corrupt-bus", 20)
    assert {tick.mode for tick in done.ticks if 10 < tick.at_s < 13} == {Mode.ACTIVE}
    status2 = [at for at, f in done.heard if f.message.endswith("_Status2") and len(f.data) == 8]
    fault = done.first(Mode.FAULT)
    assert fault.at_s - [at for at in status2 if at < 13.1][-1] <= 0.2 + TICK_S
    short = sum(len(frame.data) < 8 for _, frame in done.heard)
    rejected = {reason: count for reason, count in done.gateway.receiver.rejected.items() if count}
    assert rejected == {Reason.SHORT: short}
    after = {frame for tick in done.ticks if tick.at_s >= fault.at_s for frame in tick.frames}
    assert after <= {ZERO_TORQUE, POWER_CUT}


def causes(tick: Ticked) -> set[tuple[str, str]]:
    """Word and subject of each alarm that stands."""
    return {(held.finding.cause, held.finding.subject) for held in tick.why.alarms}


def test_a_controller_that_does_not_obey_stops_both_at_its_second_echo():
    done = ready("limp-controller", 14)
    second_s = [at for at, _ in done.heard_of("PCU1_Status1", 10)][1]
    assert done.tick_at(second_s - 1e-6).mode is Mode.ACTIVE
    assert_latched(done, second_s, 0, "PCU1_Status1.Throttle")


def test_two_controllers_that_do_not_obey_are_an_alarm_and_no_more():
    done = ready("limp-controllers", 18)
    assert {tick.mode for tick in done.ticks if tick.at_s > 10} == {Mode.ACTIVE}
    both = {("echo_below", f"PCU{number}_Status1.Throttle") for number in (1, 2)}
    second_s = [at for at, _ in done.heard_of("PCU2_Status1", 10)][1]
    assert causes(done.tick_at(second_s + TICK_S)) == both
    assert "does not obey" in str(done.tick_at(14).why.alarms[0].finding)
    assert done.tick_at(14).frames == done.tick_at(9.9).frames
    assert not causes(done.ticks[-1])


def test_a_wrong_direction_stops_both_at_its_second_echo():
    done = ready("wrong-direction", 15)
    status1 = CODEC.by_name["PCU2_Status1"]
    index = status1.spec.signal_names.index("MotorReverse")
    echoed = [(at, status1.decode(f.data).raws[index]) for at, f in done.heard_of("PCU2_Status1")]
    wrong_s = [at for at, raw in echoed if raw]
    assert wrong_s[0] < 10.6
    assert {raw for at, raw in echoed if at >= wrong_s[0]} == {1}
    before = done.tick_at(wrong_s[1] - 1e-6)
    assert before.mode is Mode.ACTIVE
    alarms = {str(held.finding) for held in before.why.alarms}
    assert any(re.match(r"PCU2_Status2.MotorSpeed raw 6\d{4}: alarm", one) for one in alarms), (
        alarms
    )
    assert_latched(done, wrong_s[1], 0, "PCU2_Status1.MotorReverse")


def spans_s(done: Drive, cause: tuple[str, str]) -> list[tuple[float, float]]:
    """From when until when each alarm of this cause stood."""
    spans: list[tuple[float, float]] = []
    for before, tick in itertools.pairwise(done.ticks):
        if cause in causes(tick) and cause not in causes(before):
            spans.append((tick.at_s, tick.at_s))
        elif cause in causes(tick):
            spans[-1] = (spans[-1][0], tick.at_s)
    return spans


@pytest.mark.parametrize("jump", ["motor", "wheel"])
def test_a_speed_that_jumps_is_an_alarm_and_no_more(jump: str):
    done, cause = {
        "motor": lambda: (
            ready("motor-speed-jump", 14),
            ("speed_step", "PCU1_Status2.MotorSpeed"),
        ),
        "wheel": lambda: (
            ready("wheel-speed-jump", 14),
            ("wheel_speed_step", "ARD2_SteeringWheel.WheelSpeedFL"),
        ),
    }[jump]()
    assert set().union(*map(causes, done.ticks[300:])) <= {cause}
    ((begin_s, end_s),) = spans_s(done, cause)
    assert 10 <= begin_s <= 10.1 + TICK_S
    assert 11.5 - 1e-9 <= end_s <= 11.8 + TICK_S, "a second after the jump back"
    assert {tick.mode for tick in done.ticks if tick.at_s > 10} == {Mode.ACTIVE}
    assert {tick.frames for tick in done.ticks if tick.at_s > 10} == {done.tick_at(9.9).frames}


def test_wheels_that_differ_for_a_second_are_an_alarm_and_no_more():
    done = ready("wheel-speeds-differ", 16)
    first_s = done.heard_of("ARD2_SteeringWheel", 10)[0][0]
    ((begin_s, end_s),) = spans_s(done, ("wheel_speed_difference", "ARD2_SteeringWheel"))
    assert first_s + 1 - 1e-9 <= begin_s <= first_s + 1 + TICK_S
    good_s = done.heard_of("ARD2_SteeringWheel", 13)[0][0]
    assert good_s + 1 - TICK_S <= end_s <= good_s + 1 + TICK_S
    assert set().union(*map(causes, done.ticks[200:])) == {
        ("wheel_speed_difference", "ARD2_SteeringWheel")
    }
    assert {tick.mode for tick in done.ticks if tick.at_s > 10} == {Mode.ACTIVE}


def roughly(dice: random.Random) -> Callable[[float], ControllerDemand]:
    """Throttle and brake in jumps, and from one direction into the other; from 8 s on."""
    asked: dict[str, Any] = {"throttle_pct": 0.0}

    def demand(at_s: float) -> ControllerDemand:
        if at_s > 8 and dice.random() < 0.03:
            asked["throttle_pct"] = dice.choice([0, 0, 10, 40, 100])
            asked["brake_pct"] = 0 if asked["throttle_pct"] else dice.choice([0, 30, 100])
            asked["regen_brake"] = dice.random() < 0.5
            asked["motor_reverse"] = dice.random() < 0.5
            asked["power_mode"] = dice.choice([PowerMode.ECO, PowerMode.TURBO])
        return ControllerDemand(**asked)

    return demand


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.ci)])
def test_a_healthy_vehicle_is_plausible_however_it_is_driven(seed: int):
    done = drive(CODEC, parse("start: {}", "s", CODEC.protocol), 120, roughly(random.Random(seed)))
    driven = [tick for tick in done.ticks if tick.at_s > 8]
    assert {tick.mode for tick in driven} == {Mode.ACTIVE}
    held = [one for t in driven for one in (*t.why.blocks, *t.why.limits, *t.why.alarms)]
    assert {one.finding.cause for one in held} == set()
    commands = [signals(CODEC, data) for tick in driven for data in tick.frames]
    assert {command["MotorReverse"] for command in commands} == {0, 1}
    assert max(command["Throttle"] for command in commands) > 95


# Reading.


def problems(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        parse(text, "s.yaml", CODEC.protocol)
    return [str(problem) for problem in caught.value.problems]


@pytest.mark.parametrize(
    ("step", "problem"),
    [
        ("{at_s: 1, fault: silense, of: BMS}",
         f'.fault: must be one of {NAMES}, not "silense"; did you mean "silence"?'),
        ("{at_s: 1, of: BMS}", f": has no fault; add `fault:` and one of {NAMES}"),
        ("{at_s: 1, fault: [], of: BMS}", f".fault: must be one of {NAMES}, not a list"),
        ("silence",
         ': must be a step such as {at_s: 10, fault: silence, of: BMS}, not "silence"'),
        ("{at_s: 1, fault: silence, of: BMS_Statuss}",
         ('.of: must be a node or a message that it sends, not "BMS_Statuss";'
         ' did you mean "BMS_Status"?')),
        ("{at_s: 1, fault: silence, of: BMT}",
         '.of: must be a node or a message that it sends, not "BMT"; did you mean "BMS"?'),
        ("{at_s: 1, fault: silence}", ".of: is missing; a node or message"),
        ("{fault: silence, of: BMS}", ".at_s: is missing; when it begins"),
        ("{at_s: -1, fault: silence, of: BMS}", ".at_s: must be at least 0 s, not -1"),
        ("{at_s: 1, for_s: 0, fault: silence, of: BMS}",
         ".for_s: must be at least 0.001 s, not 0"),
        ("{at_s: 1, fault: silence, off: BMS, of: BMS}",
         '.off: unknown key; did you mean "of"?'),
        ("{at_s: 1, fault: drop, share_pct: 101}", ".share_pct: must be at most 100 %, not 101"),
        ("{at_s: 1, fault: shorten, length_bytes: 8}",
         ".length_bytes: must be at most 7 bytes, not 8"),
        ("{at_s: 1, fault: set, signal: BMS_Status.SOK, raw: 1}",
         '.signal: must be a signal of BMS_Status, not "BMS_Status.SOK"; did you mean "SOC"?'),
        ("{at_s: 1, fault: set, signal: BMS_Stat.SOC, raw: 1}",
         ('.signal: must be MESSAGE.SIGNAL, such as BMS_Status.SOC, not "BMS_Stat.SOC";'
         ' did you mean "BMS_Status"?')),
        ("{at_s: 1, fault: set, signal: BMS_Status.SOC}",
         ".value: or raw must be given, not empty; add one of them"),
        ("{at_s: 1, fault: set, signal: BMS_Status.SOC, raw: 1, value: 1}",
         ".value: must not stand beside raw, not 1; keep one of them"),
        ("{at_s: 1, fault: set, signal: BMS_Status.CellUndervoltage, raw: 4}",
         ".raw: must be a code of 0 to 3, not 4"),
        ("{at_s: 1, fault: set, signal: BMS_Temperatures.PackTemperature1, value: -51}",
         ".value: must be -50 to 205 degC, not -51"),
        ("{at_s: 1, fault: shift, signal: ARD2_SteeringWheel.WheelSpeedFL, by: 66}",
         ".by: must be -65.535 to 65.535 km/h, not 66"),
        ("{at_s: 1, fault: shift, signal: BMS_Status.SOC}",
         ".by: is missing; added to the value, in the signal's unit; may be negative"),
        ("{at_s: 1, fault: foreign_sender, controller: PCU3}",
         '.controller: must be a motor controller, not "PCU3"; did you mean "PCU2"?'),
    ],
)  # fmt: skip
def test_a_wrong_step_is_refused_in_one_line(step: str, problem: str):
    assert problems(f"steps:\n  - {step}\n") == [f"s.yaml:2: steps.0{problem}"]


def test_everything_wrong_is_named_in_the_order_of_the_file():
    text = "start: {soc_pct: 101}\nsteps:\n  - {at_s: x, fault: drop}\n  - {fault: set}\n"
    assert [problem.partition(": must")[0].partition(": is")[0] for problem in problems(text)] == [
        "s.yaml:1: start.soc_pct",
        "s.yaml:3: steps.0.at_s",
        "s.yaml:3: steps.0.share_pct",
        "s.yaml:4: steps.1.at_s",
        "s.yaml:4: steps.1.signal",
    ]


@pytest.mark.parametrize("text", ["", "[]", "steps", "# nothing\n"])
def test_a_text_that_is_no_scenario_is_refused(text: str):
    assert len(found := problems(text)) == 1
    assert found[0].startswith("s.yaml: is no scenario; write `steps:`")


def test_what_yaml_itself_refuses_is_refused_as_in_a_configuration():
    assert problems("steps: {\n")[0].startswith("s.yaml:2: is not valid YAML")
    assert problems("steps: []\nsteps: []\n") == [
        "s.yaml:2: steps: duplicate key, first defined in line 1; remove one of them"
    ]
    assert problems("steps: 3\n") == ["s.yaml:1: steps: must be a list, - item in each line, not 3"]


def scenario_of(*steps: str) -> Scenario:
    return parse(f"steps: [{', '.join(steps)}]", "s", CODEC.protocol)


def test_a_scenario_without_steps_starts_the_vehicle_otherwise():
    scenario = parse("start: {soc_pct: 12}", "s.yaml", CODEC.protocol)
    assert (scenario.start.soc_pct, scenario.steps) == (12, ())


def decoded(done: Drive, message: str, signal: str) -> list[float]:
    codec = CODEC.by_name[message]
    place = codec.spec.signal_names.index(signal)
    heard = done.heard_of(message, from_s=3)
    return [codec.decode(frame.data).values[place] for _, frame in heard]


def test_on_a_slippery_road_the_motors_outrun_the_front_wheels():
    healthy = drive(CODEC, scenario_of(), 6)
    slipping = drive(CODEC, scenario_of("{at_s: 0, fault: slippery, friction: 0.1}"), 6)
    for controller in ("PCU1", "PCU2"):
        speeds = [
            decoded(one, f"{controller}_Status2", "MotorSpeed") for one in (healthy, slipping)
        ]
        assert max(speeds[1]) > max(speeds[0])
    wheels = [decoded(one, "ARD2_SteeringWheel", "WheelSpeedFL") for one in (healthy, slipping)]
    assert max(wheels[1]) < max(wheels[0]) / 2


def test_a_weak_battery_of_a_scenario_sags_under_load():
    weak = parse("start: {battery_resistance_ohm: 0.1}", "s", CODEC.protocol)
    volts = [
        min(decoded(drive(CODEC, one, 6), "PCU1_Status2", "BatteryVoltage"))
        for one in (scenario_of(), weak)
    ]
    assert volts[1] < volts[0] - 3


def test_each_step_is_reported_when_it_begins_and_ends():
    scenario = parse(
        "steps: [{at_s: 1, for_s: 0.5, fault: drop, of: IMU, share_pct: 50}]", "s", CODEC.protocol
    )
    assert drive(CODEC, scenario, 2).reports == [
        "1.0 s: drop of IMU share_pct 50.0 begins",
        "1.5 s: drop of IMU share_pct 50.0 ends",
    ]


def test_a_delayed_message_comes_later_by_what_the_step_says():
    step = "{at_s: 0, fault: delay, of: BMS_Status, delay_ms: 70}"
    healthy = [at for at, _ in drive(CODEC, scenario_of(), 3).heard_of("BMS_Status")]
    late = [at for at, _ in drive(CODEC, scenario_of(step), 3).heard_of("BMS_Status")]
    assert late == pytest.approx([at + 0.07 for at in healthy if at + 0.07 <= 3])


def test_every_frame_of_a_duplicated_message_comes_twice_and_of_no_other():
    step = "{at_s: 0, fault: duplicate, of: IMU_Attitude}"
    healthy, doubled = drive(CODEC, scenario_of(), 3), drive(CODEC, scenario_of(step), 3)
    twice = doubled.heard_of("IMU_Attitude")
    assert twice[0::2] == twice[1::2]
    assert len(twice) == 2 * len(healthy.heard_of("IMU_Attitude"))
    assert len(doubled.heard_of("BMS_Status")) == len(healthy.heard_of("BMS_Status"))


def test_the_command_line_names_a_wrong_scenario_and_opens_no_bus(tmp_path: Path):
    path = tmp_path / "wrong.yaml"
    path.write_text("steps: [{at_s: 1, fault: nothing}]")
    found = CliRunner().invoke(simulate, ["--scenario", str(path)])
    assert isinstance(found.exception, ConfigError)
    assert found.exception.exit_code == 78


def test_the_command_line_plays_a_scenario(tmp_path: Path):
    path = tmp_path / "silence.yaml"
    path.write_text("start: {soc_pct: 50}\nsteps: [{at_s: 0, for_s: 0.2, fault: silence, of: BMS}]")
    log = tmp_path / "played.log"
    options = ["--interface", "virtual", "--channel", "scenario", "--duration", "0.7"]
    found = CliRunner().invoke(simulate, [*options, "--scenario", str(path), "--log", str(log)])
    assert found.exit_code == 0, found.output
    assert "0.0 s: silence of BMS begins\n" in found.stderr
    assert "0.2 s: silence of BMS ends\n" in found.stderr
    statuses = re.findall(r"1808D0F4#....0000(..)", log.read_text())
    assert statuses == ["32"], "SOC 50 in the one frame after the silence"


def test_the_page_names_every_fault_and_every_key_of_it():
    page = (ROOT / "docs/simulator.md").read_text()
    for name, model in FAULTS.items():
        row = next(line for line in page.splitlines() if line.startswith(f"| `{name}` |"))
        for key in model.model_fields.keys() - {"at_s", "for_s", "fault"}:
            assert f"`{key}" in row, (name, key)


def test_the_examples_of_the_page_are_scenarios():
    page = (ROOT / "docs/simulator.md").read_text()
    examples = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    assert examples
    for example in examples:
        assert isinstance(parse(example, "example", CODEC.protocol), Scenario)
