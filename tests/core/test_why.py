"""`why` answers in one line what a person needs at three in the morning."""

import itertools
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.core.simulated_drive import (
    MS,
    PROTOCOL,
    RECEIVED,
    Drive,
    active,
    in_mode,
    standby,
)
from vcu_gateway.core.causes import (
    BATTERY_EFFECTS,
    BLOCKING,
    CONTROLLER_EFFECTS,
    LIMITING,
    Effect,
    Finding,
    HeldCause,
)
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand
from vcu_gateway.core.supervisor import FaultClass, LatchedFault, Mode
from vcu_gateway.core.why import LONGEST_CHARACTERS, Explanation, Reasons, next_step


def test_while_listening():
    drive = Drive()
    drive.silent |= {"BMS_Status", "PCU1_Status1", "PCU2_Status1", "BMS_Temperatures"}
    drive.demanded = None
    slow = {message.name for message in PROTOCOL.received_by("VCU") if message.period_ms > 50}
    others = slow - {"BMS_Status", "PCU1_Status1", "PCU2_Status1"}  # silent, and only told
    assert {"BMS_Temperatures", "ARD2_SteeringWheel"} <= others
    drive.tick()
    assert drive.sentence == (
        "starting; listening for another sender of our frames; "
        "blocked by BMS_Status, PCU1_Status2 and 1 other never received: stop (for 0.0 s); "
        f"limited by 4 causes; alarm {len(others)} causes; wait"
    )


def test_while_waiting_for_messages():
    drive = Drive()
    drive.silent.add("BMS_Status")
    drive.run(4050)
    assert drive.sentence == ("starting; waiting for BMS_Status; demand of driver 0 ms old; wait")


def test_in_a_healthy_standby():
    assert standby().sentence == "standby; demand of driver 0 ms old; arm"


def test_in_standby_it_says_what_speaks_against_arming():
    drive = standby()
    drive.demanded = ControllerDemand(throttle_pct=5)
    drive.tick()
    assert drive.sentence == (
        "standby; demand of driver 0 ms old; before arming: the demanded throttle is not 0"
    )


def test_an_expired_demand_is_told_with_its_age():
    drive = standby()
    drive.demanded = None
    drive.run(300)
    assert drive.sentence == (
        "standby; demand of driver 300 ms old, expired; before arming: there is no fresh demand"
    )


def test_a_bench_demand_has_no_age():
    drive = Drive(bench_demand=ControllerDemand())
    drive.demanded = None
    drive.until(Mode.STANDBY).run(1500)
    assert drive.sentence == "standby; demand of bench; arm"


def test_in_active_it_says_what_limits_since_when_and_whether_it_still_stands():
    drive = active()
    assert drive.sentence == "active; demand of driver 0 ms old; drive; disarm to end"
    drive.codes |= {"BMS_Status.CellUndervoltage": 1, "BMS_Status.VoltageImbalance": 1}
    drive.receive("BMS_Status")
    drive.tick()
    drive.run(1000)
    assert drive.sentence == (
        "active; limited by BMS_Status.CellUndervoltage 1 (level1): power limit (for 1.0 s); "
        "alarm BMS_Status.VoltageImbalance 1 (level1): alarm (for 1.0 s); "
        "demand of driver 0 ms old; drive; disarm to end"
    )
    drive.codes.clear()
    drive.receive("BMS_Status")
    drive.run(500)
    assert "power limit (for 1.5 s, gone and held)" in drive.sentence


def test_in_fault_it_says_what_latched_what_blocks_and_what_comes_first():
    drive = active()
    drive.gateway.requests.emergency_stop()
    drive.tick()
    assert drive.sentence == (
        "fault; latched (service): emergency stop requested: cut; "
        "blocked by emergency stop requested: cut (for 0.0 s); "
        "first: emergency stop requested: cut stands or stood a moment ago; then service reset"
    )
    drive.run(2000)
    assert drive.sentence == (
        "fault; latched (service): emergency stop requested: cut; demand of driver 0 ms old; "
        "service reset"
    )


def test_a_fault_that_the_driver_may_reset_asks_for_no_service():
    drive = in_mode(Mode.FAULT)
    assert drive.sentence == (
        "fault; latched (driver): command 0008A7D0: stop; demand of driver 0 ms old; reset"
    )


def test_while_ending():
    drive = in_mode(Mode.STOPPING)
    assert drive.sentence == "stopping; demand of driver 0 ms old; the gateway is ending"


@pytest.mark.parametrize(
    ("mode", "refusal", "step"),
    [
        (Mode.STARTING, "", "wait"),
        (Mode.STANDBY, "", "arm"),
        (Mode.STANDBY, "no", "before arming: no"),
        (Mode.ACTIVE, "", "drive; disarm to end"),
        (Mode.FAULT, "", "reset"),
        (Mode.FAULT, "no", "first: no; then reset"),
        (Mode.STOPPING, "", "the gateway is ending"),
    ],
)
def test_every_mode_has_a_next_step(mode, refusal, step):
    assert next_step(mode, None, refusal) == step


@pytest.mark.parametrize(
    ("refusal", "step"), [("", "service reset"), ("no", "first: no; then service reset")]
)
def test_a_cut_names_the_level_of_its_reset(refusal, step):
    latch = LatchedFault(FaultClass.SERVICE, "cut", 0)
    assert next_step(Mode.FAULT, latch, refusal) == step


def reasons(seen_ns: int, detail: str = "1101 ms", effect=Effect.POWER_LIMIT) -> Reasons:
    held = (HeldCause(Finding("late", "BMS_Status", effect, detail), 0, seen_ns),)
    return Reasons(Mode.ACTIVE, None, held, (), "driver", 200, demand_fresh=True, refusal="")


def test_the_same_answer_at_another_time_has_the_same_signature():
    assert reasons(0).signature() == reasons(500 * MS, "1601 ms").signature()
    assert reasons(0).signature() != reasons(0, effect=Effect.REGEN_LIMIT).signature()


@pytest.mark.parametrize(
    "other",
    [
        {"mode": Mode.STANDBY},
        {"latch": LatchedFault(FaultClass.DRIVER, "", 0)},
        {"held": ()},
        {"waits": ("waiting for BMS_Status",)},
        {"demand_source": "other"},
        {"demand_fresh": False},
    ],
    ids=lambda other: next(iter(other)),
)
def test_an_answer_that_a_person_reads_differently_has_another_signature(other):
    assert reasons(0).signature() != reasons(0)._replace(**other).signature()


def test_the_answer_is_data_too():
    drive = active()
    drive.codes["BMS_Status.CellUndervoltage"] = 1
    drive.run(500)
    found = drive.gateway.why(drive.now_ns)
    assert (found.now_ns, found.mode, found.latch) == (drive.now_ns, Mode.ACTIVE, None)
    assert [(one.finding.subject, one.finding.effect) for one in found.limits] == [
        ("BMS_Status.CellUndervoltage", Effect.POWER_LIMIT)
    ]
    assert (found.blocks, found.alarms, found.waits) == ((), (), ())
    assert (found.demand_source, found.demand_age_ns, found.demand_fresh) == ("driver", 0, True)
    assert found.demand_ttl_ms == 200


def test_between_two_ticks_a_cause_stands_as_the_last_tick_judged_it():
    drive = standby()
    drive.codes["BMS_Status.CellUndervoltage"] = 1
    drive.run(1000)
    sentence = drive.gateway.why(drive.now_ns + 20 * MS).sentence()
    assert "power limit (for " in sentence
    assert "gone and held" not in sentence


def test_the_headline_names_the_first_of_many_causes_and_how_many_more():
    drive = Drive()
    drive.silent |= {"BMS_Status", "PCU1_Status2"}
    drive.tick()
    assert drive.gateway.why(drive.now_ns).headline() == (
        "starting; listening for another sender of our frames; "
        "blocked by BMS_Status never received: stop and 2 more; wait"
    )


def test_the_headline_names_the_first_of_the_messages_that_are_waited_for():
    drive = Drive()
    drive.silent |= {"BMS_Status", "PCU1_Status2"}
    drive.run(2050)
    assert drive.gateway.why(drive.now_ns).headline() == (
        "starting; waiting for BMS_Status and 1 other; "
        "blocked by BMS_Status never received: stop and 1 more; wait"
    )


def test_the_headline_of_a_healthy_standby_is_short():
    drive = standby()
    assert drive.gateway.why(drive.now_ns).headline() == "standby; arm"


def test_the_headline_of_a_limited_drive_names_the_limit():
    drive = active()
    drive.codes["BMS_Status.CellUndervoltage"] = 1
    drive.run(600)
    assert drive.gateway.why(drive.now_ns).headline() == (
        "active; limited by BMS_Status.CellUndervoltage 1 (level1): power limit; "
        "drive; disarm to end"
    )


def test_the_headline_of_a_fault_names_what_latched():
    drive = in_mode(Mode.FAULT)
    assert drive.gateway.why(drive.now_ns).headline().startswith("fault; latched: ")


# Of many causes the sentence names what matters most, and counts the rest.


def told(**parts: Any) -> str:
    """The sentence of a drive one second old with these parts."""
    bare: dict[str, Any] = {
        "now_ns": 1_000 * MS,
        "judged_ns": 1_000 * MS,
        "mode": Mode.STARTING,
        "latch": None,
        **dict.fromkeys(("blocks", "limits", "alarms", "waits"), ()),
        "demand_source": None,
        "demand_age_ns": None,
        "demand_ttl_ms": None,
        "demand_fresh": False,
        "next_step": "wait",
    }
    return Explanation(**bare | parts).sentence()


def held(*subjects: str, effect: Effect = Effect.STOP, detail: str = "old", seen_ms: int = 1_000):
    """A cause of each subject, since the beginning."""
    return tuple(
        HeldCause(Finding("stale", subject, effect, detail), 0, seen_ms * MS)
        for subject in subjects
    )


def test_a_fresh_start_on_a_silent_bus_is_told_in_a_short_sentence():
    drive = Drive(required_messages=RECEIVED)
    drive.silent |= set(RECEIVED)
    drive.demanded = None
    for _ in range(100):
        drive.tick()
        assert len(drive.sentence) <= LONGEST_CHARACTERS
    assert drive.sentence == (
        f"starting; waiting for {', '.join(RECEIVED[:3])} and {len(RECEIVED) - 3} others; "
        "no demand; wait"
    )
    assert len(drive.gateway.why(drive.now_ns).waits) == len(RECEIVED)


def test_a_fresh_start_with_everything_there_is_short_at_every_tick():
    drive = Drive()
    for _ in range(60):
        drive.tick()
        assert len(drive.sentence) <= LONGEST_CHARACTERS


@pytest.mark.parametrize(
    ("waits", "part"),
    [
        (("waiting for A: 1 of 3 good frames",), "waiting for A: 1 of 3 good frames"),
        (("waiting for A: 1 of 3 good frames", "waiting for B"), "waiting for A and B"),
        (("waiting for A", "waiting for B", "waiting for C"), "waiting for A, B and C"),
        (tuple(f"waiting for {name}" for name in "ABCD"), "waiting for A, B, C and 1 other"),
        (tuple(f"waiting for {name}" for name in "ABCDE"), "waiting for A, B, C and 2 others"),
        (("our frames", "waiting for A"), "our frames; waiting for A"),
        (("our frames", "waiting for A", "waiting for B"), "our frames; waiting for A and B"),
    ],
)
def test_messages_that_are_waited_for_are_one_list(waits, part):
    assert told(waits=waits) == f"starting; {part}; no demand; wait"


def test_what_is_waited_for_is_not_told_again_as_a_cause():
    waits = ("waiting for A: 1 of 3 good frames",)
    sentence = told(waits=waits, blocks=held("A", "B"), limits=held("A", effect=Effect.POWER_LIMIT))
    assert sentence == (
        "starting; waiting for A: 1 of 3 good frames; blocked by B old: stop (for 1.0 s); "
        "no demand; wait"
    )


def test_causes_of_which_the_same_is_to_be_said_are_one_group():
    assert told(blocks=held("A", "B", "C", "D")) == (
        "starting; blocked by A, B, C and 1 other old: stop (for 1.0 s); no demand; wait"
    )
    blocks = (*held("A", "B"), *held("C", detail="lost"), *held("D", seen_ms=900))
    assert told(blocks=blocks) == (
        "starting; blocked by A and B old: stop (for 1.0 s), C lost: stop (for 1.0 s), "
        "D old: stop (for 1.0 s, gone and held); no demand; wait"
    )


def test_a_cut_is_named_before_a_stop_and_what_stands_before_what_is_held():
    blocks = (*held("A", seen_ms=900), *held("B"), *held("C", effect=Effect.CUT))
    sentence = told(blocks=blocks)
    assert sentence.index("C old: cut") < sentence.index("B old: stop") < sentence.index("A old")


def test_groups_beyond_the_third_are_counted_by_their_causes():
    blocks = [cause for name in "ABCD" for cause in held(name, detail=name.lower())]
    blocks += held("E", detail="d")
    assert told(blocks=tuple(blocks)).endswith("C c: stop (for 1.0 s) and 2 more; no demand; wait")


LATCH = LatchedFault(FaultClass.SERVICE, "hot", 0)
BLOCKS = held(*"ABCDE")
LIMITS = held(*"ABCDE", effect=Effect.POWER_LIMIT)
ALARMS = held(*"ABCDE", effect=Effect.ALARM)
WAITS = tuple(f"waiting for {name}" for name in "FGHI")


def listed(effect: str) -> list[str]:
    """Of five causes, from the longest form to the shortest that names one."""
    names = ("A, B, C and 2 others", "A, B and 3 others", "A and 4 others")
    return [f"{some} old: {effect} (for 1.0 s)" for some in names]


B3, B2, B1, B0 = [f"blocked by {form}; " for form in (*listed("stop"), "5 causes")]
L3, L2, L1, L0 = [f"limited by {form}; " for form in (*listed("power limit"), "5 causes")]
A3, A2, A1, A0 = [f"alarm {form}; " for form in (*listed("alarm"), "5 causes")]
W3, W2, W1 = [
    f"waiting for {some}; "
    for some in ("F, G, H and 1 other", "F, G and 2 others", "F and 3 others")
]
L, D = "latched (service): hot; ", "no demand; "
CAUSES = {"blocks": BLOCKS, "limits": LIMITS, "alarms": ALARMS}


@pytest.mark.parametrize(
    ("parts", "forms"),
    [
        (
            CAUSES,
            [
                *(B3 + L3 + A3 + D, B3 + L3 + A2 + D, B3 + L3 + A1 + D, B3 + L3 + A0 + D),
                *(B3 + L2 + A0 + D, B3 + L1 + A0 + D, B2 + L1 + A0 + D, B2 + L1 + A0),
                *(B2 + L0 + A0, B1 + L0 + A0, B1 + L0, B1, B0, ""),
            ],
        ),
        (
            {"limits": LIMITS, "alarms": ALARMS},
            [
                *(L3 + A3 + D, L3 + A2 + D, L3 + A1 + D, L3 + A0 + D, L2 + A0 + D),
                *(L1 + A0 + D, L1 + A0, L0 + A0, L0, ""),
            ],
        ),
        (
            {"latch": LATCH, "blocks": BLOCKS},
            [L + B3 + D, L + B2 + D, L + B2, L + B1, L + B0, L, "latched (service); "],
        ),
        (
            {"waits": WAITS, "blocks": BLOCKS},
            [W3 + B3 + D, W3 + B2 + D, W3 + B2, W3 + B1, W2 + B1, W1 + B1, W1 + B0, W1],
        ),
    ],
)
def test_what_matters_least_becomes_shorter_first(parts, forms):
    for form, shorter in itertools.pairwise(forms):
        step = "x" * (LONGEST_CHARACTERS - len(f"starting; {form}"))
        assert told(**parts, next_step=step) == f"starting; {form}{step}"
        assert told(**parts, next_step=f"{step}x") == f"starting; {shorter}{step}x"


def test_of_a_limited_drive_every_limit_is_named_before_the_demand_goes():
    parts = {"mode": Mode.ACTIVE, "demand_source": "bench", "next_step": "drive; disarm to end"}
    limits = held("A" * 15, effect=Effect.POWER_LIMIT) + held("B" * 15, effect=Effect.REGEN_LIMIT)
    alarms = held("C" * 15, effect=Effect.ALARM)
    assert told(limits=limits, alarms=alarms, **parts) == (
        f"active; limited by {'A' * 15} old: power limit (for 1.0 s), {'B' * 15} old: regen limit "
        f"(for 1.0 s); alarm {'C' * 15} old: alarm (for 1.0 s); demand of bench; "
        "drive; disarm to end"
    )


def test_a_sentence_of_exactly_the_bound_is_whole_and_a_longer_one_is_cut():
    room = LONGEST_CHARACTERS - len("starting; no demand; ")
    assert told(next_step="x" * room) == f"starting; no demand; {'x' * room}"
    room = LONGEST_CHARACTERS - len("starting; ")
    assert told(next_step="x" * room) == f"starting; {'x' * room}"
    assert told(next_step="x" * (room + 1)) == f"starting; {'x' * (room - 1)}…"


WORDS = st.text(st.characters(exclude_categories=("C", "Z")), min_size=1, max_size=80)


def any_causes(effects: frozenset[Effect]):
    findings = st.builds(
        Finding, WORDS, WORDS, st.sampled_from(sorted(effects, key=str)), WORDS | st.just("")
    )
    times_ns = st.integers(0, 2**50)
    return st.lists(st.builds(HeldCause, findings, times_ns, times_ns), max_size=40).map(tuple)


@given(
    st.builds(
        Explanation,
        mode=st.sampled_from(Mode),
        latch=st.none() | st.builds(LatchedFault, st.sampled_from(FaultClass), WORDS, st.just(0)),
        blocks=any_causes(BLOCKING),
        limits=any_causes(LIMITING),
        alarms=any_causes(frozenset({Effect.ALARM})),
        waits=st.lists(WORDS.map("waiting for {}".format) | WORDS, max_size=20).map(tuple),
        demand_source=st.none() | WORDS,
        next_step=WORDS,
    )
)
def test_no_set_of_causes_makes_a_sentence_longer_than_its_bound(found):
    sentence = found.sentence()
    assert len(sentence) <= LONGEST_CHARACTERS
    assert sentence.startswith(found.mode.value)


IN_MODE = {mode: in_mode(mode) for mode in Mode}
CODES = st.dictionaries(
    st.sampled_from(
        [f"BMS_Status.{name}" for name in BATTERY_EFFECTS]
        + [f"{owner}_Status1.{name}" for owner in CONTROLLERS for name in CONTROLLER_EFFECTS]
    ),
    st.integers(1, 3),
)


@given(CODES, st.sets(st.sampled_from(RECEIVED)), st.sampled_from(Mode), st.booleans())
def test_a_gateway_in_any_trouble_says_in_its_sentence_what_to_do(codes, silent, mode, stopped):
    drive = IN_MODE[mode].twin()
    if stopped:
        drive.gateway.requests.emergency_stop()
    drive.codes |= codes
    for name in RECEIVED:
        drive.receive(name)
    drive.silent |= silent
    for _ in range(15):
        drive.tick()
        found = drive.gateway.why(drive.now_ns)
        assert len(found.sentence()) <= LONGEST_CHARACTERS
        assert found.sentence().endswith(found.next_step)
