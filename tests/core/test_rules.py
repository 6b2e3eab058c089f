"""Every rule healthy, at its limit, one step beyond, unknown, stale and missing.

The rows repeat docs/safety.md, Causes, to the number; they take nothing from the rules.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.core.simulated_drive import MS, NOW_NS, PERIOD_NS, PROTOCOL, RECEIVED, rule_inputs
from vcu_gateway.core.link import LinkState, LinkStatus
from vcu_gateway.core.pedal_frames import PedalObservation
from vcu_gateway.core.plausibility import Observed, ThrottleExcess
from vcu_gateway.core.rules import RULES, RuleInputs, findings
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.spec import MessageSpec

BY_NAME = {rule.__name__: rule for rule in RULES}

HEALTHY, AT, BEYOND = "healthy", "at the limit", "one step beyond"
UNKNOWN, STALE, MISSING = "unknown", "stale", "missing"
OF_A_MESSAGE = {HEALTHY, AT, BEYOND, UNKNOWN, STALE, MISSING}
OF_THE_GATEWAY = {HEALTHY, AT, BEYOND}
"""Facts of the gateway itself are counted, not received: they cannot be unknown or stale."""

KINDS = {
    "battery_codes": OF_A_MESSAGE,
    "controller_codes": OF_A_MESSAGE,
    "battery_late": OF_A_MESSAGE - {UNKNOWN},  # an age has no codes
    "battery_life": OF_A_MESSAGE - {UNKNOWN},  # one bit has no code to spare
    "stale": OF_A_MESSAGE - {UNKNOWN},
    "out_of_range": OF_A_MESSAGE,
    "throttle_echo": OF_A_MESSAGE - {AT, UNKNOWN},  # test_plausibility.py has the limit
    "echo_below": OF_A_MESSAGE - {UNKNOWN},  # frames in a row are counted
    "echo_direction": OF_A_MESSAGE - {UNKNOWN},
    "speed_steps": OF_THE_GATEWAY - {AT},  # seen or not
    "wheel_speeds": OF_A_MESSAGE - {UNKNOWN, MISSING},
    "unconfirmed": OF_THE_GATEWAY,
    "link_down": OF_THE_GATEWAY,
    "foreign_sender": OF_THE_GATEWAY - {AT},  # there or not
    "tick_late": OF_THE_GATEWAY,
    "emergency_stop": OF_THE_GATEWAY - {AT},
    "gate_blocked": OF_THE_GATEWAY - {AT},
    "restart_state": OF_THE_GATEWAY - {AT},
    "pedals": OF_THE_GATEWAY | {UNKNOWN},  # test_pedal_frames.py has the frames
}


@dataclass(frozen=True)
class Row:
    """What one rule finds in these inputs: a set of 'subject EFFECT'."""

    rule: str
    kind: str
    finds: frozenset[str]
    broken: Mapping[str, Any] = field(hash=False, default_factory=dict)
    label: str = ""

    def __str__(self) -> str:
        return f"{self.rule}-{self.kind}-{self.label}".rstrip("-")


def row(rule: str, kind: str, finds: str = "", label: str = "", **broken: Any) -> Row:
    """`finds` is 'subject EFFECT, subject EFFECT'."""
    found = frozenset(part.strip() for part in finds.split(",") if part.strip())
    return Row(rule, kind, found, broken, label)


def every(subject: str, effects: str) -> str:
    return ", ".join(f"{subject} {effect}" for effect in effects.split())


# Codes: signal, then the effects of each code; codes in brackets are reserved (E13).

BATTERY = """
CellOvervoltage       0 -                         1 REGEN_LIMIT
                      2 REGEN_OFF                 3 REGEN_OFF
CellUndervoltage      0 -                         1 POWER_LIMIT
                      2 STOP                      3 CUT
DischargeOvercurrent  0 -                         1 REGEN_LIMIT+POWER_LIMIT
                      2 CUT                      (3) CUT
TemperatureImbalance  0 -                         1 ALARM
                      2 ALARM                    (3) ALARM
Overtemperature       0 -                         1 ALARM
                      2 CUT                      (3) CUT
Undertemperature      0 -                         1 REGEN_OFF
                      2 CUT                      (3) CUT
VoltageImbalance      0 -                         1 ALARM
InternalFault         0 -                         1 CUT
"""
CONTROLLER = """
TemperatureProtectLevel  0 -                      1 TURBO_OFF
                         2 STOP                  (3) STOP
VoltageLevel            (0) POWER_LIMIT+REGEN_OFF 1 POWER_LIMIT
                         2 -  3 -  4 -            5 REGEN_OFF
                        (6) POWER_LIMIT+REGEN_OFF (7) POWER_LIMIT+REGEN_OFF
"""


def code_rows(rule: str, message: str, table: str) -> list[Row]:
    """One row for each code of each signal."""
    rows, signal, words = [], "", table.split()
    while words:
        if not words[0].strip("()").isdigit():
            signal = words.pop(0)
        code, effects = words.pop(0), words.pop(0).replace("+", " ").replace("-", "")
        raw = int(code.strip("()"))
        kind = AT if not effects else UNKNOWN if code.startswith("(") else BEYOND
        subject = f"{message}.{signal}"
        finds = every(subject, effects)
        rows.append(row(rule, kind, finds, f"{subject}={raw}", codes={subject: raw}))
    return rows


BATTERY_ROWS = [
    row("battery_codes", HEALTHY),
    *code_rows("battery_codes", "BMS_Status", BATTERY),
    row(
        "battery_codes", STALE, "BMS_Status.CellUndervoltage CUT",
        "the last known level counts until another is known",
        codes={"BMS_Status.CellUndervoltage": 3}, ages_ns={"BMS_Status": 60_000 * MS},
    ),
    row("battery_codes", STALE, ages_ns={"BMS_Status": 60_000 * MS}),
    row("battery_codes", MISSING, never=["BMS_Status"]),
    row(
        "battery_codes", BEYOND,
        "BMS_Status.CellOvervoltage REGEN_OFF, BMS_Status.CellUndervoltage CUT,"
        "BMS_Status.DischargeOvercurrent CUT, BMS_Status.TemperatureImbalance ALARM,"
        "BMS_Status.Overtemperature CUT, BMS_Status.Undertemperature CUT,"
        "BMS_Status.VoltageImbalance ALARM, BMS_Status.InternalFault CUT",
        "everything at once",
        codes={
            "BMS_Status.CellOvervoltage": 3, "BMS_Status.CellUndervoltage": 3,
            "BMS_Status.DischargeOvercurrent": 3, "BMS_Status.TemperatureImbalance": 3,
            "BMS_Status.Overtemperature": 3, "BMS_Status.Undertemperature": 3,
            "BMS_Status.VoltageImbalance": 1, "BMS_Status.InternalFault": 1,
        },
    ),
]  # fmt: skip

CONTROLLER_ROWS = [
    row("controller_codes", HEALTHY),
    *(
        one
        for controller in ("PCU1", "PCU2")
        for one in [
            *code_rows("controller_codes", f"{controller}_Status1", CONTROLLER),
            row(
                "controller_codes", STALE, f"{controller}_Status1.TemperatureProtectLevel STOP",
                f"the last known level of {controller} counts until another is known",
                codes={f"{controller}_Status1.TemperatureProtectLevel": 2},
                ages_ns={f"{controller}_Status1": 60_000 * MS},
            ),
            row("controller_codes", MISSING, label=controller, never=[f"{controller}_Status1"]),
        ]
    ),
]  # fmt: skip

LIMITED = every("BMS_Status", "REGEN_LIMIT POWER_LIMIT")
LATE_ROWS = [
    row("battery_late", HEALTHY),
    row("battery_late", AT, ages_ns={"BMS_Status": 1100 * MS}),
    row("battery_late", BEYOND, LIMITED, ages_ns={"BMS_Status": 1100 * MS + 1}),
    row("battery_late", STALE, LIMITED, ages_ns={"BMS_Status": 1600 * MS + 1}),
    row("battery_late", MISSING, label="for the rule of staleness", never=["BMS_Status"]),
    row(
        "battery_late", BEYOND, LIMITED, "a configured deadline",
        ages_ns={"BMS_Status": 700 * MS + 1}, settings=Settings(late_after_ms={"BMS_Status": 700}),
    ),
    row("battery_late", HEALTHY, label="others are not the battery",
        ages_ns={name: 1100 * MS + 1 for name in RECEIVED if name != "BMS_Status"}),
]  # fmt: skip

LIFE = "BMS_Status.LifeSignal"
LIFE_LIMITED = every(LIFE, "REGEN_LIMIT POWER_LIMIT")
LIFE_ROWS = [
    row("battery_life", HEALTHY),
    row("battery_life", AT, label="one frame", life_frames=1),
    row("battery_life", BEYOND, LIFE_LIMITED, "2 frames", life_frames=2),
    row("battery_life", BEYOND, f"{LIFE_LIMITED}, {LIFE} STOP", "3 frames", life_frames=3),
    row("battery_life", BEYOND, f"{LIFE_LIMITED}, {LIFE} STOP", "4 frames", life_frames=4),
    row("battery_life", STALE, label="toggled", ages_ns={"BMS_Status": 60_000 * MS}),
    row("battery_life", MISSING, never=["BMS_Status"]),
]

STALE_AFTER_MS = {500: 1600, 100: 300, 50: 200, 10: 100}
"""By the message's period in ms."""

SILENCE = {
    "BMS_Status": "STOP",
    "PCU1_Status2": "STOP",
    "PCU2_Status2": "STOP",
    "PCU1_Status1": "TURBO_OFF POWER_LIMIT",
    "PCU2_Status1": "TURBO_OFF POWER_LIMIT",
}
"""Effects by message; ALARM for every other one that the gateway receives."""


def silence_rows(message: MessageSpec) -> list[Row]:
    name, effects = message.name, SILENCE.get(message.name, "ALARM")
    finds, required = every(name, effects), Settings(required_messages=(name,))
    stops = finds if "STOP" in effects else f"{finds}, {name} STOP"
    deadline_ns = STALE_AFTER_MS[message.period_ms] * MS
    return [
        row("stale", AT, "", name, ages_ns={name: deadline_ns}),
        row("stale", BEYOND, finds, name, ages_ns={name: deadline_ns + 1}),
        row("stale", STALE, finds, name, ages_ns={name: 86_400_000 * MS}),
        row("stale", MISSING, finds, name, never=[name]),
        row("stale", BEYOND, stops, f"{name} is required",
            ages_ns={name: deadline_ns + 1}, settings=required),
        row("stale", MISSING, stops, f"{name} is required", never=[name], settings=required),
        row("stale", MISSING, finds, f"{name}, nothing required", never=[name],
            settings=Settings(required_messages=())),
        row("stale", AT, "", f"{name} slightly ahead", ages_ns={name: -20 * MS}),
        row("stale", BEYOND, finds, f"{name} in the future", ages_ns={name: -20 * MS - 1}),
        row("stale", BEYOND, finds, f"{name}, a configured deadline",
            ages_ns={name: 90 * MS + 1}, settings=Settings(stale_after_ms={name: 90})),
    ]  # fmt: skip


STALE_ROWS = [
    row("stale", HEALTHY),
    *(one for message in PROTOCOL.received_by("VCU") for one in silence_rows(message)),
]

SPEED = "PCU1_Status2.MotorSpeed"
RANGE_ROWS = [
    row("out_of_range", HEALTHY),
    row("out_of_range", AT, codes={"BMS_Status.SOC": 100}),
    row("out_of_range", BEYOND, "BMS_Status.SOC ALARM", codes={"BMS_Status.SOC": 101}),
    row("out_of_range", AT, codes={"BMS_Status.PackVoltage": 10_000}),
    row("out_of_range", BEYOND, "BMS_Status.PackVoltage ALARM",
        codes={"BMS_Status.PackVoltage": 10_001}),
    row("out_of_range", AT, codes={SPEED: 6000}),
    row("out_of_range", BEYOND, f"{SPEED} ALARM", codes={SPEED: 6001}),
    row("out_of_range", UNKNOWN, f"{SPEED} ALARM", codes={SPEED: 0xFFFF}),
    row("out_of_range", BEYOND, "PCU2_Status2.MotorSpeed ALARM",
        codes={"PCU2_Status2.MotorSpeed": 6001}),
    row("out_of_range", BEYOND, "", "a message that is not required",
        codes={"BMS_Temperatures.PackTemperature1": 251}),
    row("out_of_range", BEYOND, "BMS_Temperatures.PackTemperature1 ALARM", "the same, required",
        codes={"BMS_Temperatures.PackTemperature1": 251},
        settings=Settings(required_messages=("BMS_Temperatures",))),
    row("out_of_range", AT, "", "the same, required",
        codes={"BMS_Temperatures.PackTemperature1": 250},
        settings=Settings(required_messages=("BMS_Temperatures",))),
    row("out_of_range", STALE, "BMS_Status.SOC ALARM", "the last known value",
        codes={"BMS_Status.SOC": 101}, ages_ns={"BMS_Status": 60_000 * MS}),
    row("out_of_range", MISSING, never=["BMS_Status", "PCU1_Status2", "PCU2_Status2"]),
]  # fmt: skip


EXCESS = Observed(echo_above={"PCU2": ThrottleExcess(39.39, 34.0)})
ECHO_ROWS = [
    row("throttle_echo", HEALTHY),
    row("throttle_echo", BEYOND, "PCU2_Status1.Throttle STOP", observed=EXCESS),
    row("throttle_echo", STALE, "", "judged by its age instead",
        observed=EXCESS, ages_ns={"PCU2_Status1": 1600 * MS + 1}),
    row("throttle_echo", MISSING, "", observed=EXCESS, never=["PCU2_Status1"]),
]  # fmt: skip


def runs_of(rule: str, runs: str, subject: str, alone: str, both: str) -> list[Row]:
    """A rule that counts frames in a row of each controller's Status1."""

    def observed(*, obeys: str = "", **counts: int) -> dict[str, Any]:
        odd = {name: n for name, n in counts.items() if n}
        facts: dict[str, Any] = {runs: odd, "echoes_below": frozenset(odd) - {obeys}}
        return {"observed": Observed(**facts)}

    one, other = (f"{name}_Status1.{subject}" for name in ("PCU1", "PCU2"))
    status1 = ("PCU1_Status1", "PCU2_Status1")
    return [
        row(rule, HEALTHY),
        row(rule, AT, "", "one frame", **observed(PCU1=1, PCU2=0)),
        row(rule, AT, "", "one frame of both", **observed(PCU1=1, PCU2=1)),
        row(rule, BEYOND, f"{one} {alone}", "two frames", **observed(PCU1=2, PCU2=0)),
        row(rule, BEYOND, f"{other} {alone}", "two frames", **observed(PCU1=0, PCU2=2)),
        row(rule, BEYOND, f"{one} {both}", "the other begins", **observed(PCU1=2, PCU2=1)),
        row(rule, BEYOND, f"{one} {both}, {other} {both}", "both", **observed(PCU1=3, PCU2=2)),
        row(rule, BEYOND, f"{one} {alone}", "the other obeys again",
            **observed(PCU1=2, PCU2=1, obeys="PCU2")),
        row(rule, BEYOND, f"{one} {both}, {other} {alone}", "the first obeys again",
            **observed(PCU1=2, PCU2=2, obeys="PCU1")),
        row(rule, STALE, f"{one} {alone}", "the other is stale",
            **observed(PCU1=2, PCU2=2), ages_ns={status1[1]: 1600 * MS + 1}),
        row(rule, STALE, "", "judged by their age instead",
            **observed(PCU1=2, PCU2=2), ages_ns=dict.fromkeys(status1, 1600 * MS + 1)),
        row(rule, MISSING, f"{one} {alone}", "the other", **observed(PCU1=2), never=[status1[1]]),
    ]  # fmt: skip


def apart(for_ns: int) -> dict[str, Any]:
    return {"observed": Observed(wheels_apart_ns=for_ns)}


WHEELS = "ARD2_SteeringWheel"
PLAUSIBILITY_ROWS = [
    *runs_of("echo_below", "echo_below", "Throttle", "STOP", "ALARM"),
    *runs_of("echo_direction", "echo_direction", "MotorReverse", "STOP", "STOP"),
    row("speed_steps", HEALTHY),
    row("speed_steps", BEYOND, "PCU2_Status2.MotorSpeed ALARM",
        observed=Observed(speed_steps_rpm={"PCU2": 2001.0})),
    row("wheel_speeds", HEALTHY),
    row("wheel_speeds", BEYOND, f"{WHEELS}.WheelSpeedFL ALARM", "a step",
        observed=Observed(wheel_steps_kmh={"WheelSpeedFL": 20.001})),
    row("wheel_speeds", AT, "", "apart for less than a second", **apart(1000 * MS - 1)),
    row("wheel_speeds", BEYOND, f"{WHEELS} ALARM", "apart for a second", **apart(1000 * MS)),
    row("wheel_speeds", STALE, "", "judged by its age instead",
        **apart(2000 * MS), ages_ns={WHEELS: 300 * MS + 1}),
]  # fmt: skip

SENDING_ROWS = [
    row("unconfirmed", HEALTHY),
    row("unconfirmed", AT, unconfirmed_ticks=2),
    row("unconfirmed", BEYOND, "own frames STOP", unconfirmed_ticks=3),
    row("foreign_sender", HEALTHY),
    row("foreign_sender", BEYOND, "command STOP", foreign_sender=0x0008A7D0),
    row("foreign_sender", BEYOND, "command STOP", foreign_sender=0x1808A8D0),
    row("gate_blocked", HEALTHY),
    row("gate_blocked", BEYOND, "gate STOP", blocked_by_gate="unarmed"),
]  # fmt: skip


def link(state: LinkState, for_ns: int) -> dict[str, LinkStatus]:
    return {"link": LinkStatus(state, NOW_NS - for_ns)}


LINK_ROWS = [
    row("link_down", HEALTHY),
    row("link_down", AT, "", "warned for a minute", **link(LinkState.WARNING, 60_000 * MS)),
    row("link_down", AT, "", "passive for 1 s in all", passive_ns=1000 * MS),
    row("link_down", BEYOND, "link STOP", "passive for longer", passive_ns=1000 * MS + 1),
    row("link_down", BEYOND, "link STOP", "bus off", **link(LinkState.BUS_OFF, 0)),
    row("link_down", BEYOND, "link STOP", "lost", **link(LinkState.LOST, 0)),
]  # fmt: skip

TICK_ROWS = [
    row("tick_late", HEALTHY),
    row("tick_late", AT, "", "4 periods", tick_late_ns=4 * PERIOD_NS),
    row("tick_late", BEYOND, "tick STOP", "4 periods", tick_late_ns=4 * PERIOD_NS + 1),
    row("tick_late", AT, "", "of 20 ms", tick_late_ns=80 * MS, period_ns=20 * MS),
    row("tick_late", BEYOND, "tick STOP", "of 20 ms", tick_late_ns=80 * MS + 1, period_ns=20 * MS),
    row("emergency_stop", HEALTHY),
    row("emergency_stop", BEYOND, "emergency stop CUT", emergency_stop=True),
    row("restart_state", HEALTHY),
    row("restart_state", BEYOND, "restart state ALARM", restart_state_failure="No space"),
]

PEDAL_ROWS = [
    row("pedals", HEALTHY),
    row("pedals", AT, pedals=PedalObservation("Pedals", 2, "checksum wrong", {})),
    row("pedals", BEYOND, "Pedals ALARM", pedals=PedalObservation("Pedals", 3, "", {})),
    row(
        "pedals", UNKNOWN, "Pedals.Throttle1 ALARM, Pedals.Brake ALARM",
        pedals=PedalObservation("Pedals", 0, "", {"Throttle1": "not known", "Brake": "at 111 %"}),
    ),
]  # fmt: skip

ROWS = [
    *BATTERY_ROWS, *CONTROLLER_ROWS, *LATE_ROWS, *LIFE_ROWS, *STALE_ROWS, *RANGE_ROWS,
    *ECHO_ROWS, *PLAUSIBILITY_ROWS, *SENDING_ROWS,
    *LINK_ROWS, *TICK_ROWS, *PEDAL_ROWS,
]  # fmt: skip


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_a_rule_finds_exactly_what_the_safety_page_says(row):
    found = list(BY_NAME[row.rule](rule_inputs(**row.broken)))
    assert {f"{one.subject} {one.effect.name}" for one in found} == row.finds
    assert len(found) == len(row.finds), "nothing is found twice"


def test_every_rule_has_rows_of_every_kind_that_it_can_have():
    tried = {name: {one.kind for one in ROWS if one.rule == name} for name in BY_NAME}
    assert tried == KINDS, "a rule without rows, or rows without a rule"


def test_every_code_that_a_coded_signal_can_carry_has_a_row():
    tried = {
        (name, raw)
        for one in (*BATTERY_ROWS, *CONTROLLER_ROWS)
        for name, raw in one.broken.get("codes", {}).items()
    }
    for name in {name for name, _ in tried}:
        message, signal = name.split(".")
        codes = range(1 << PROTOCOL.message(message).signal(signal).length_bits)
        assert {raw for owner, raw in tried if owner == name} == set(codes), name


def test_healthy_inputs_have_no_findings():
    assert findings(rule_inputs()) == ()


def test_all_findings_are_those_of_every_rule():
    broken = rule_inputs(
        codes={"BMS_Status.CellUndervoltage": 2}, unconfirmed_ticks=3, never=["IMU_Attitude"]
    )
    assert {(one.subject, one.effect.name) for one in findings(broken)} == {
        ("BMS_Status.CellUndervoltage", "STOP"),
        ("own frames", "STOP"),
        ("IMU_Attitude", "ALARM"),
    }


FACTS = st.fixed_dictionaries(
    {},
    optional={
        "link": st.builds(LinkStatus, st.sampled_from(LinkState), st.just(0)),
        "passive_ns": st.sampled_from([0, 1, 1_000 * MS, 1_000 * MS + 1]),
        "tick_late_ns": st.sampled_from([-MS, 0, PERIOD_NS + 1, 4 * PERIOD_NS, 4 * PERIOD_NS + 1]),
        "unconfirmed_ticks": st.integers(0, 4),
        "foreign_sender": st.just(0x0008A7D0),
        "emergency_stop": st.booleans(),
        "blocked_by_gate": st.just("length"),
        "restart_state_failure": st.sampled_from(["", "No space"]),
        "pedals": st.just(PedalObservation("Pedals", 3, "", {})),
        "observed": st.builds(Observed, wheels_apart_ns=st.sampled_from([None, 1_000 * MS])),
        "codes": st.just({"BMS_Status.CellUndervoltage": 2}),
        "never": st.just(["BMS_Temperatures"]),
    },
)


@given(FACTS)
def test_no_rule_that_is_passed_by_would_have_found_anything(facts):
    inputs = rule_inputs(**facts)
    assert findings(inputs) == tuple(one for rule in RULES for one in rule(inputs))


def asked(inputs: RuleInputs) -> set[str]:
    """Names of the rules that are called for the findings."""
    called = set()
    before = sys.getprofile()
    sys.setprofile(lambda frame, event, _: called.add(frame.f_code.co_name))
    try:
        findings(inputs)
    finally:
        sys.setprofile(before)
    return called & BY_NAME.keys()


def test_a_healthy_tick_asks_only_the_rules_about_messages():
    assert asked(rule_inputs()) == {
        "battery_codes", "controller_codes", "battery_late", "battery_life", "stale",
        "out_of_range",
    }  # fmt: skip


def test_only_overcharge_of_level_3_is_held_until_restart():
    kept = {
        (one.subject, one.detail)
        for each in ROWS
        for one in findings(rule_inputs(**each.broken))
        if one.until_restart
    }
    assert kept == {("BMS_Status.CellOvervoltage", "3 (level3)")}


def test_only_another_sender_and_the_gate_latch_from_every_mode_without_a_cut():
    latching = {
        one.subject for each in ROWS for one in findings(rule_inputs(**each.broken)) if one.latches
    }
    assert latching == {"command", "gate"}


@pytest.mark.parametrize(
    ("broken", "detail"),
    [
        ({"codes": {"BMS_Status.CellUndervoltage": 2}}, "BMS_Status.CellUndervoltage 2 (level2)"),
        ({"codes": {"PCU1_Status1.VoltageLevel": 7}}, "PCU1_Status1.VoltageLevel 7 (reserved)"),
        ({"ages_ns": {"BMS_Status": 1100 * MS + 1}}, "BMS_Status 1100 ms"),
        ({"life_frames": 3}, "BMS_Status.LifeSignal unchanged in 3 frames"),
        ({"never": ["IMU_Attitude"]}, "IMU_Attitude never received"),
        ({"ages_ns": {"IMU_Attitude": 101 * MS}}, "IMU_Attitude 101 ms"),
        ({"codes": {"BMS_Status.SOC": 101}}, "BMS_Status.SOC raw 101"),
        ({"observed": Observed(echo_above={"PCU1": ThrottleExcess(39.0, 0.0)})},
         "PCU1_Status1.Throttle 39.0 %, commanded 0.0 %"),
        ({"observed": Observed(echo_below={"PCU1": 2})},
         "PCU1_Status1.Throttle does not obey, in 2 frames"),
        ({"observed": Observed(echo_direction={"PCU1": 2})},
         "PCU1_Status1.MotorReverse not as commanded, in 2 frames"),
        ({"observed": Observed(speed_steps_rpm={"PCU1": 2001.0})},
         "PCU1_Status2.MotorSpeed changed by 2001 rpm"),
        ({"observed": Observed(wheel_steps_kmh={"WheelSpeedFL": 20.04})},
         "ARD2_SteeringWheel.WheelSpeedFL changed by 20.0 km/h"),
        ({"observed": Observed(wheels_apart_ns=1200 * MS)},
         "ARD2_SteeringWheel wheels differ for 1200 ms"),
        ({"passive_ns": 1001 * MS}, "link error passive for 1001 ms of 5 s"),
        ({"unconfirmed_ticks": 3}, "own frames for 3 ticks"),
        (link(LinkState.BUS_OFF, 0), "link bus off"),
        ({"foreign_sender": 0x0008A7D0}, "command 0008A7D0"),
        ({"tick_late_ns": 201 * MS}, "tick 201 ms"),
        ({"emergency_stop": True}, "emergency stop requested"),
        ({"blocked_by_gate": "unarmed"}, "gate unarmed"),
        ({"restart_state_failure": "No space"}, "restart state not kept (No space)"),
    ],
)  # fmt: skip
def test_a_finding_names_its_subject_and_its_value(broken, detail):
    assert {str(one).rsplit(":", 1)[0] for one in findings(rule_inputs(**broken))} == {detail}
