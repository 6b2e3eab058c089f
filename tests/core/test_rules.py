"""Every rule healthy, at its limit, one step beyond, unknown, stale and missing.

The rows repeat SAFETY.md's table of causes to the number; they take nothing from the rules.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import pytest

from tests.core.safety_world import MS, NOW_NS, PERIOD_NS, PROTOCOL, RECEIVED, world
from vcu_gateway.core.link import Link, LinkState
from vcu_gateway.core.rules import RULES, findings
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.world import Sent

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
    "throttle_echo": OF_A_MESSAGE,
    "unconfirmed": OF_THE_GATEWAY,
    "link_down": OF_THE_GATEWAY,
    "foreign_sender": OF_THE_GATEWAY - {AT},  # there or not
    "tick_late": OF_THE_GATEWAY,
    "emergency_stop": OF_THE_GATEWAY - {AT},
    "gate_blocked": OF_THE_GATEWAY - {AT},
}


@dataclass(frozen=True)
class Row:
    """What one rule finds in a world: a set of 'subject EFFECT'."""

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

SILENCE = {
    "BMS_Status": (1600, "STOP"),
    "PCU1_Status2": (200, "STOP"),
    "PCU2_Status2": (200, "STOP"),
    "PCU1_Status1": (1600, "TURBO_OFF POWER_LIMIT"),
    "PCU2_Status1": (1600, "TURBO_OFF POWER_LIMIT"),
    "IMU_Acceleration": (100, "ALARM"),
    "IMU_AngularRate": (100, "ALARM"),
    "IMU_Attitude": (100, "ALARM"),
    "ARD2_SteeringWheel": (300, "ALARM"),
    "BMS_Temperatures": (1600, "ALARM"),
}
"""Every message that the gateway receives: stale after (ms), effects."""


def silence_rows(name: str, deadline_ms: int, effects: str) -> list[Row]:
    finds, required = every(name, effects), Settings(required=(name,))
    stops = finds if "STOP" in effects else f"{finds}, {name} STOP"
    deadline_ns = deadline_ms * MS
    return [
        row("stale", AT, "", name, ages_ns={name: deadline_ns}),
        row("stale", BEYOND, finds, name, ages_ns={name: deadline_ns + 1}),
        row("stale", STALE, finds, name, ages_ns={name: 86_400_000 * MS}),
        row("stale", MISSING, finds, name, never=[name]),
        row("stale", BEYOND, stops, f"{name} is required",
            ages_ns={name: deadline_ns + 1}, settings=required),
        row("stale", MISSING, stops, f"{name} is required", never=[name], settings=required),
        row("stale", AT, "", f"{name} slightly ahead", ages_ns={name: -20 * MS}),
        row("stale", BEYOND, finds, f"{name} in the future", ages_ns={name: -20 * MS - 1}),
        row("stale", BEYOND, finds, f"{name}, a configured deadline",
            ages_ns={name: 90 * MS + 1}, settings=Settings(stale_after_ms={name: 90})),
    ]  # fmt: skip


STALE_ROWS = [
    row("stale", HEALTHY),
    *(one for name, (ms, effects) in SILENCE.items() for one in silence_rows(name, ms, effects)),
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
        settings=Settings(required=("BMS_Temperatures",))),
    row("out_of_range", AT, "", "the same, required",
        codes={"BMS_Temperatures.PackTemperature1": 250},
        settings=Settings(required=("BMS_Temperatures",))),
    row("out_of_range", STALE, "BMS_Status.SOC ALARM", "the last known value",
        codes={"BMS_Status.SOC": 101}, ages_ns={"BMS_Status": 60_000 * MS}),
    row("out_of_range", MISSING, never=["BMS_Status", "PCU1_Status2", "PCU2_Status2"]),
]  # fmt: skip


def echo_rows(controller: str) -> list[Row]:
    """The echo came 100 ms ago; a bit is 0.39 %: 100 bits are 39 %, 12 bits are below 5 %."""
    message, echo_ns = f"{controller}_Status1", NOW_NS - 100 * MS
    finds = f"{message}.Throttle STOP"

    def echoed(raw: int, *sent: tuple[int, float]) -> dict[str, Any]:
        history = {controller: tuple(Sent(echo_ns - age_ns, pct) for age_ns, pct in sent)}
        ages_ns, codes = {message: 100 * MS}, {f"{message}.Throttle": raw}
        return {"codes": codes, "ages_ns": ages_ns, "history": history}

    def of(kind: str, finds: str, label: str, broken: dict[str, Any]) -> Row:
        return row("throttle_echo", kind, finds, f"{controller} {label}", **broken)

    return [
        of(HEALTHY, "", "obeys", echoed(100, (50 * MS, 39.0))),
        of(HEALTHY, "", "obeys less", echoed(0, (50 * MS, 39.0))),
        of(AT, "", "5 % more", echoed(100, (50 * MS, 34.0))),
        of(BEYOND, finds, "a little more than 5 %", echoed(100, (50 * MS, 33.999))),
        of(BEYOND, finds, "one bit more than 5 %", echoed(101, (50 * MS, 34.0))),
        of(AT, "", "12 bits above 0", echoed(12, (50 * MS, 0.0))),
        of(BEYOND, finds, "13 bits above 0", echoed(13, (50 * MS, 0.0))),
        of(AT, "", "a command of one second ago", echoed(100, (1000 * MS, 39.0), (0, 0.0))),
        of(BEYOND, finds, "an older command", echoed(100, (1000 * MS + 1, 39.0), (0, 0.0))),
        of(AT, "", "a command at that instant", echoed(100, (0, 39.0))),
        of(BEYOND, finds, "a command after the echo", echoed(100, (-1, 39.0))),
        of(BEYOND, finds, "a throttle never commanded", echoed(13)),
        of(UNKNOWN, finds, "the highest code", echoed(255, (0, 39.0))),
        of(STALE, "", "judged by its age instead",
           echoed(255) | {"ages_ns": {message: 1600 * MS + 1}}),
        of(MISSING, "", "nothing is echoed", {"never": [message]}),
    ]  # fmt: skip


SENDING_ROWS = [
    row("unconfirmed", HEALTHY),
    row("unconfirmed", AT, unconfirmed_ticks=2),
    row("unconfirmed", BEYOND, "own frames STOP", unconfirmed_ticks=3),
    row("unconfirmed", BEYOND, "", "where the bus cannot tell",
        unconfirmed_ticks=3, settings=Settings(expect_echo=False)),
    row("foreign_sender", HEALTHY),
    row("foreign_sender", BEYOND, "command 0008A7D0 STOP", foreign_sender=0x0008A7D0),
    row("foreign_sender", BEYOND, "command 1808A8D0 STOP", foreign_sender=0x1808A8D0),
    row("gate_blocked", HEALTHY),
    row("gate_blocked", BEYOND, "gate STOP", blocked_by_gate="unarmed"),
]  # fmt: skip


def link(state: LinkState, for_ns: int) -> dict[str, Link]:
    return {"link": Link(state, NOW_NS - for_ns)}


LINK_ROWS = [
    row("link_down", HEALTHY),
    row("link_down", AT, "", "warned for a minute", **link(LinkState.WARNING, 60_000 * MS)),
    row("link_down", AT, "", "passive", **link(LinkState.PASSIVE, 0)),
    row("link_down", AT, "", "passive for 1 s", **link(LinkState.PASSIVE, 1000 * MS)),
    row("link_down", BEYOND, "link STOP", "passive for longer",
        **link(LinkState.PASSIVE, 1000 * MS + 1)),
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
]

ROWS = [
    *BATTERY_ROWS, *CONTROLLER_ROWS, *LATE_ROWS, *LIFE_ROWS, *STALE_ROWS, *RANGE_ROWS,
    *echo_rows("PCU1"), *echo_rows("PCU2"), *SENDING_ROWS, *LINK_ROWS, *TICK_ROWS,
]  # fmt: skip


@pytest.mark.parametrize("row", ROWS, ids=str)
def test_a_rule_finds_exactly_what_the_safety_page_says(row):
    found = list(BY_NAME[row.rule](world(**row.broken)))
    assert {f"{one.subject} {one.effect.name}" for one in found} == row.finds
    assert len(found) == len(row.finds), "nothing is found twice"


def test_every_rule_has_rows_of_every_kind_that_it_can_have():
    tried = {name: {one.kind for one in ROWS if one.rule == name} for name in BY_NAME}
    assert tried == KINDS, "a rule without rows, or rows without a rule"


def test_every_message_that_is_received_has_rows_for_its_silence():
    assert set(SILENCE) == set(RECEIVED)


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


def test_a_healthy_world_has_no_findings():
    assert findings(world()) == ()


def test_all_findings_are_those_of_every_rule():
    broken = world(
        codes={"BMS_Status.CellUndervoltage": 2}, unconfirmed_ticks=3, never=["IMU_Attitude"]
    )
    assert {(one.subject, one.effect.name) for one in findings(broken)} == {
        ("BMS_Status.CellUndervoltage", "STOP"),
        ("own frames", "STOP"),
        ("IMU_Attitude", "ALARM"),
    }


def test_only_overcharge_of_level_3_is_held_until_restart():
    kept = {
        (one.subject, one.detail)
        for each in ROWS
        for one in findings(world(**each.broken))
        if one.until_restart
    }
    assert kept == {("BMS_Status.CellOvervoltage", "3 (level3)")}


def test_only_another_sender_and_the_gate_latch_from_every_mode_without_a_cut():
    latching = {
        one.subject for each in ROWS for one in findings(world(**each.broken)) if one.latches
    }
    assert latching == {"command 0008A7D0", "command 1808A8D0", "gate"}


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
        ({"codes": {"PCU1_Status1.Throttle": 100}},
         "PCU1_Status1.Throttle 39.0 %, commanded 0.0 %"),
        ({"unconfirmed_ticks": 3}, "own frames for 3 ticks"),
        (link(LinkState.BUS_OFF, 0), "link bus off"),
        ({"foreign_sender": 0x0008A7D0}, "command 0008A7D0"),
        ({"tick_late_ns": 201 * MS}, "tick 201 ms"),
        ({"emergency_stop": True}, "emergency stop requested"),
        ({"blocked_by_gate": "unarmed"}, "gate unarmed"),
    ],
)  # fmt: skip
def test_a_finding_names_its_subject_and_its_value(broken, detail):
    assert {str(one).rsplit(":", 1)[0] for one in findings(world(**broken))} == {detail}
