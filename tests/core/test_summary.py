"""The summary: one thing in plain words, which `why` says too."""

import itertools
from collections.abc import Iterator

import pytest

from tests.core.simulated_drive import MS, RECEIVED, Drive, active, rule_inputs
from tests.core.test_operator_requests import NOTHING_DEMANDED, STANDBY, throttle
from tests.core.test_operator_requests import inputs as requests
from tests.core.test_rules import BY_NAME, ROWS
from vcu_gateway.core import calls
from vcu_gateway.core.causes import BLOCKING, LIMITING, Effect, Finding, HeldCause
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.operator_requests import arming_refusal
from vcu_gateway.core.summary import LONGEST_SUMMARY_CHARACTERS, summary
from vcu_gateway.core.supervisor import FaultClass, LatchedFault, Mode
from vcu_gateway.core.why import Explanation, Reasons, explained

NOW_NS = 10_000 * MS
WORDS = {
    "BMS": "the battery: ",
    "PCU1": "motor controller 1: ",
    "PCU2": "motor controller 2: ",
    "ARD2": "steering and wheels: ",
    "IMU": "the inertial unit: ",
    "emergency stop": "the emergency stop",
    "link": "the bus: ",
    "own frames": "the bus: our frames are not confirmed",
    "command": "the bus: another sender, ",
    "tick": "this computer: tick ",
    "gate": "the gateway: frame blocked, ",
    "restart state": "the restart state: not kept",
}
"""How a finding is named, by its subject or the node in it; written apart from the code."""


def _found() -> Iterator[Finding]:
    """Every finding that a row of the rules' tests has, once for each detail."""
    for row in ROWS:
        yield from BY_NAME[row.rule](rule_inputs(**row.broken))


FINDINGS = sorted(set(_found()), key=repr)
FINDING = Finding("stale", "BMS_Status", Effect.STOP, "never received")


def said(drive: Drive) -> str:
    return summary(drive.gateway.why(drive.now_ns))


def explanation(mode: Mode, *findings: Finding) -> Explanation:
    """These causes for 1.5 s in this mode, with the refusal and the latch that follow."""
    held = tuple(HeldCause(one, NOW_NS - 1500 * MS, NOW_NS) for one in findings)
    blocking = [one for one in findings if one.effect in BLOCKING]
    refusal = f"{blocking[0]} stands or stood a moment ago" if blocking else ""
    latch = None
    if mode is Mode.FAULT:
        latch = LatchedFault(FaultClass.DRIVER, str(findings[0]) if findings else "x", 0)
    judged = refusal if mode in (Mode.STANDBY, Mode.FAULT) else ""
    reasons = Reasons(mode, latch, held, (), "driver", 200, demand_fresh=True, refusal=judged)
    return explained(reasons, NOW_NS, NOW_NS, 0)


def words_of(finding: Finding) -> str:
    return WORDS.get(finding.subject) or WORDS[finding.subject.partition("_")[0]]


def test_the_rows_of_the_rules_have_every_effect_and_every_subject():
    assert {one.effect for one in FINDINGS} == set(Effect) - {Effect.CAP}
    # Pedals on CAN have the names of the vehicle's own DBC, and only raise an alarm.
    subjects = {one.subject for one in FINDINGS if not one.cause.startswith("pedal_")}
    used = {one if one in WORDS else one.partition("_")[0] for one in subjects}
    assert used == set(WORDS)


@pytest.mark.parametrize("mode", Mode)
def test_in_every_mode_the_first_cause_that_blocks_or_limits_is_named(mode):
    for finding in FINDINGS:
        line = summary(explanation(mode, finding))
        assert 0 < len(line) <= LONGEST_SUMMARY_CHARACTERS
        assert "…" not in line
        counts = finding.effect in BLOCKING or (mode is Mode.ACTIVE and finding.effect in LIMITING)
        if mode is Mode.STOPPING:
            assert line == "the gateway is ending"
        elif counts:
            assert words_of(finding) in line, finding
            assert finding.subject in WORDS or finding.subject.rpartition(".")[2] in line, finding


@pytest.mark.parametrize("mode", [Mode.STANDBY, Mode.FAULT, Mode.ACTIVE])
def test_of_two_causes_it_names_the_one_that_why_names_first(mode):
    blocking = [one for one in FINDINGS if one.effect is Effect.STOP and one.cause != "link"]
    for one, two in itertools.permutations(blocking[::7], 2):
        found = explanation(mode, one, two)
        assert words_of(found.blocks[0].finding) in summary(found)


def test_of_two_limits_it_names_the_first_and_counts_the_other():
    one = Finding("late", "BMS_Status", Effect.POWER_LIMIT, "1101 ms")
    two = Finding("stale", "PCU1_Status1", Effect.TURBO_OFF, "never received")
    line = summary(explanation(Mode.ACTIVE, one, two))
    assert line == "limited by the battery: BMS_Status late and 1 more, since 1.5 s"


def test_a_limit_of_a_curve_is_named_with_its_input_and_how_much_is_left():
    hot = Finding("curves.x", "motor temperature", Effect.CAP, "101 °C: power at most 38.0 kW")
    line = summary(explanation(Mode.ACTIVE, hot))
    assert line == "limited by motor temperature 101 °C: power at most 38.0 kW"
    slip = Finding("laws.slip", "slip of PCU1", Effect.CAP, "throttle at most 24 %")
    line = summary(explanation(Mode.ACTIVE, slip))
    assert line == "limited by slip of PCU1: throttle at most 24 %, since 1.5 s"


def test_what_a_start_waits_for_is_the_first_message_that_why_waits_for():
    for silent in itertools.combinations(("BMS_Status", "PCU1_Status2", "PCU2_Status2"), 2):
        drive = Drive()
        drive.silent |= set(silent)
        drive.run(2050)
        first = drive.gateway.why(drive.now_ns).waits[0].removeprefix("waiting for ")
        assert f": {first} and 1 more, since 2.0 s" in said(drive)


def test_a_start_is_told_step_by_step():
    drive = Drive(qualify_frames=4)
    drive.silent.add("BMS_Status")
    drive.demanded = None
    drive.tick()
    assert said(drive) == "waiting: another sender of our frames may be on the bus"
    drive.run(3000)
    assert said(drive) == "waiting for the battery: BMS_Status, since 3.0 s"
    drive.silent.clear()
    drive.run(700)
    assert said(drive) == "waiting for the battery: BMS_Status, 1 of 4 good frames"
    drive.until(Mode.STANDBY).run(1500)
    assert said(drive) == "waiting for the pedals or a program: no fresh demand"
    drive.demanded = ControllerDemand(throttle_pct=5)
    drive.tick()
    assert said(drive) == "waiting for the released pedal: the throttle is not 0"
    drive.demanded = ControllerDemand()
    drive.tick()
    assert said(drive) == "waiting for the pedal to stay released for 200 ms"
    drive.run(300)
    assert said(drive) == "waiting for you: press Arm"
    assert drive.arm().granted
    drive.tick()
    assert said(drive) == "drive: nothing limits it"


def test_what_is_back_and_held_a_while_is_not_waited_for():
    drive = active()
    drive.silent.add("BMS_Status")
    drive.run(3000)
    assert said(drive) == "stopped, waiting for the battery: BMS_Status, since 1.4 s"
    drive.silent.clear()
    drive.run(600)
    assert said(drive) == "stopped, waiting a moment after the battery: BMS_Status missing"
    drive.run(1500)
    assert said(drive) == "stopped by the battery: BMS_Status missing, reset first"


@pytest.mark.parametrize(
    ("code", "line"),
    [
        ("CellUndervoltage", "limited by the battery: CellUndervoltage 1 (level1), over soon"),
        (
            "CellOvervoltage",
            "limited by the battery: CellOvervoltage 3 (level3), until the restart",
        ),
    ],
)
def test_a_limit_whose_cause_is_over_says_how_long_it_stays(code, line):
    drive = active()
    drive.codes[f"BMS_Status.{code}"] = 1 if code == "CellUndervoltage" else 3
    drive.run(1500)
    assert ", since " in said(drive)
    drive.codes.clear()
    drive.run(600)
    assert said(drive) == line


def test_a_dead_link_comes_before_the_messages_that_it_keeps_away():
    drive = Drive()
    drive.silent |= set(RECEIVED)
    drive.gateway.apply(calls.LoseLink(drive.now_ns))
    drive.run(3000)
    assert said(drive) == "waiting for the bus: lost and 3 more, since 3.0 s"


@pytest.mark.parametrize(
    ("mode", "changes", "line"),
    [
        (
            Mode.STANDBY,
            {"refusal": "the gateway was restarted 3 times in this drive; find out why"},
            "restarted too often: 3 times in this drive; find out why",
        ),
        (
            Mode.STANDBY,
            {"refusal": f"the restart state cannot be kept: {'x' * 80}"},
            f"the restart state cannot be kept: {'x' * 34}…",
        ),
        (Mode.STANDBY, {"refusal": "a new reason"}, "before arming: a new reason"),
        (Mode.STANDBY, {"waits": ("a new condition",)}, "a new condition"),
        (
            Mode.ACTIVE,
            {"waits": ("power mode turbo until the throttle is below 5 % (PCU1 and PCU2)",)},
            "waiting for power mode turbo until the throttle is below 5 %",
        ),
        (
            Mode.ACTIVE,
            {"waits": ("throttle 0 until released below 5 %: brake over throttle",)},
            "waiting for the released pedal: brake over throttle",
        ),
        (Mode.ACTIVE, {"demand_fresh": False}, "waiting for a fresh demand"),
        (Mode.STARTING, {}, "waiting for the next tick"),
        (Mode.STARTING, {"waits": ("waiting for My",)}, "waiting for My"),
        (
            Mode.STARTING,
            {"waits": (f"waiting for BMS_{'x' * 36}: 3 of 10 good frames",)},
            f"waiting for the battery: BMS_{'x' * 36}",
        ),
        (Mode.STANDBY, {"waits": ("x" * 70,)}, f"{'x' * 68}…"),
        (
            Mode.FAULT,
            {"refusal": "the demanded throttle is not 0"},
            "stopped, waiting for the released pedal: the throttle is not 0",
        ),
        (Mode.FAULT, {"latch": None}, "stopped, reset first"),
        (
            Mode.FAULT,
            {"latch": LatchedFault(FaultClass.SERVICE, "before this start: emergency stop", 0)},
            "stopped: before this start: emergency stop, service reset first",
        ),
        (
            Mode.FAULT,
            {"latch": LatchedFault(FaultClass.DRIVER, "BMS_Status 1650 ms: stop", 0)},
            "stopped by the battery: BMS_Status missing, reset first",
        ),
    ],
)
def test_what_is_no_cause_has_words_too(mode, changes, line):
    assert summary(explanation(mode)._replace(**changes)) == line


def test_every_reason_against_arming_has_words_or_is_a_cause():
    healthy = requests(*STANDBY)
    for changes in (
        {"restarts": 3},
        {"listening": True},
        {"restart_state_failure": "No space"},
        {"demanded": None},
        {"demanded": throttle(5, 0)},
        {"zero_for_ns": 0},
        {"demanded": NOTHING_DEMANDED | {"PCU2": ControllerDemand(motor_reverse=True)}},
        {"reverse_pending": True},
        {"speed_pending": True},
    ):
        refusal = arming_refusal(healthy._replace(**changes))
        line = summary(explanation(Mode.STANDBY)._replace(refusal=refusal))
        assert refusal
        assert not line.startswith("before arming")


def test_a_name_that_has_no_room_is_cut_and_the_part_stays():
    found = explanation(Mode.FAULT, Finding("code", f"BMS_Status.{'x' * 70}", Effect.CUT, "2"))
    assert summary(found).startswith("stopped, blocked by the battery: xxx")
    assert summary(found).endswith("x…")


@pytest.mark.parametrize(
    ("seconds", "since"), [(1.5, "1.5 s"), (119, "119.0 s"), (120, "2 min"), (9000, "2 h")]
)
def test_a_long_time_is_told_in_minutes_and_hours(seconds, since):
    found = explanation(Mode.STANDBY, FINDING)
    later = found._replace(now_ns=found.blocks[0].since_ns + int(seconds * 1000) * MS)
    assert summary(later).endswith(f", since {since}")


def test_an_emergency_stop_says_that_a_reset_comes_first_and_then_what_holds_it():
    drive = active()
    drive.gateway.requests.emergency_stop()
    drive.tick()
    assert said(drive) == "stopped by the emergency stop, service reset first"
    drive.run(3000)
    assert said(drive) == "stopped by the emergency stop, service reset first"
    drive.silent.add("PCU1_Status2")
    drive.run(1000)
    assert said(drive).startswith("stopped, waiting for motor controller 1: PCU1_Status2, since ")
