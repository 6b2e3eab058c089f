"""How long a cause counts: from the tick that sees it until the hold after the first without it."""

import itertools
import logging

import pytest

from tests.core.simulated_drive import MS
from vcu_gateway.core.causes import BLOCKING, LIMITING, Causes, Effect, Finding, Severity

HOLD_NS = 1000 * MS
STOP = Finding("code", "BMS_Status.CellUndervoltage", Effect.STOP, "2 (level2)")
LIMIT = Finding("late", "BMS_Status", Effect.POWER_LIMIT, "1101 ms")
FOREVER = Finding("code", "BMS_Status.CellOvervoltage", Effect.REGEN_OFF, "3", until_restart=True)


def names(events):
    return [event.name for event in events]


def test_every_effect_is_of_one_kind():
    assert {Effect.ALARM} | LIMITING | BLOCKING == set(Effect)
    assert {Effect.STOP, Effect.CUT} == BLOCKING
    assert not LIMITING & BLOCKING


def test_a_finding_reads_as_its_subject_its_value_if_any_and_its_effect():
    assert str(Finding("gate", "gate", Effect.STOP, "unarmed")) == "gate unarmed: stop"
    assert str(Finding("gate", "gate", Effect.STOP)) == "gate: stop"


def test_a_cause_counts_in_the_very_tick_that_sees_it():
    causes = Causes()
    assert causes.effects() == frozenset()
    causes.update([STOP], HOLD_NS, 0)
    assert causes.effects() == {Effect.STOP}
    assert causes.held[0].stands(0)


def test_two_causes_of_one_subject_with_one_effect_are_told_apart():
    subject, causes = "PCU1_Status1.Throttle", Causes()
    found = [Finding(cause, subject, Effect.STOP) for cause in ("throttle_echo", "echo_below")]
    assert names(causes.update(found, HOLD_NS, 0)) == ["cause_began"] * 2
    assert [held.finding for held in causes.held] == found


@pytest.mark.parametrize(
    ("absent_ns", "counts"), [(1, True), (HOLD_NS - 1, True), (HOLD_NS, False)]
)
def test_a_cause_counts_until_it_was_absent_for_the_whole_hold(absent_ns, counts):
    causes = Causes()
    causes.update([STOP], HOLD_NS, 5)
    assert causes.update([], HOLD_NS, 50 * MS) == []
    events = causes.update([], HOLD_NS, 50 * MS + absent_ns)
    assert (Effect.STOP in causes.effects()) is counts
    assert names(events) == ([] if counts else ["cause_ended"])


def test_the_hold_begins_with_the_first_tick_that_does_not_see_the_cause():
    causes = Causes()
    causes.update([STOP], HOLD_NS, 0)
    assert causes.update([], HOLD_NS, 10 * HOLD_NS) == [], "however late that tick is"
    assert names(causes.update([], HOLD_NS, 11 * HOLD_NS)) == ["cause_ended"]


def test_a_cause_seen_again_within_the_hold_is_to_be_absent_for_all_of_it_once_more():
    causes = Causes()
    causes.update([STOP], HOLD_NS, 0)
    causes.update([], HOLD_NS, 50 * MS)
    causes.update([STOP], HOLD_NS, 900 * MS)
    causes.update([], HOLD_NS, 950 * MS)
    assert causes.update([], HOLD_NS, 950 * MS + HOLD_NS - 1) == []
    assert names(causes.update([], HOLD_NS, 950 * MS + HOLD_NS)) == ["cause_ended"]


def test_a_cause_that_is_held_stood_but_does_not_stand():
    causes = Causes()
    causes.update([STOP], HOLD_NS, 0)
    causes.update([], HOLD_NS, 50 * MS)
    (held,) = causes.held
    assert not held.stands(50 * MS)
    assert (held.since_ns, held.seen_ns) == (0, 0)


def test_a_hold_of_nothing_ends_a_cause_in_the_first_tick_without_it():
    causes = Causes()
    causes.update([STOP], 0, 7)
    assert causes.effects() == {Effect.STOP}, "what is seen now counts whatever the hold"
    causes.update([], 0, 8)
    assert causes.effects() == frozenset()


def test_a_flickering_cause_keeps_its_effect_and_gives_one_event():
    causes, events = Causes(), []
    for tick in range(100):
        found = [STOP] if tick % 2 else []
        events += causes.update(found, HOLD_NS, tick * 50 * MS)
        assert (Effect.STOP in causes.effects()) is (tick >= 1)
    assert names(events) == ["cause_began"]
    assert causes.held[0].since_ns == 50 * MS
    events += causes.update([], HOLD_NS, 100 * 50 * MS)
    events += causes.update([], HOLD_NS, 100 * 50 * MS + HOLD_NS - 1)
    assert names(events) == ["cause_began"]
    events += causes.update([], HOLD_NS, 100 * 50 * MS + HOLD_NS)
    events += causes.update([], HOLD_NS, 100 * 50 * MS + HOLD_NS + 1)
    assert names(events) == ["cause_began", "cause_ended"]


def test_a_cause_that_comes_back_after_its_end_begins_anew():
    causes = Causes()
    causes.update([STOP], HOLD_NS, 0)
    causes.update([], HOLD_NS, 1)
    causes.update([], HOLD_NS, HOLD_NS + 1)
    assert names(causes.update([STOP], HOLD_NS, 2 * HOLD_NS)) == ["cause_began"]
    assert causes.held[0].since_ns == 2 * HOLD_NS


def test_what_is_held_until_restart_never_ends():
    causes = Causes()
    causes.update([FOREVER], HOLD_NS, 0)
    assert causes.update([], HOLD_NS, 365 * 86_400_000 * MS) == []
    assert causes.effects() == {Effect.REGEN_OFF}


@pytest.mark.parametrize("order", list(itertools.permutations(range(3))))
def test_a_milder_code_of_the_same_signal_does_not_end_what_is_held_until_restart(order):
    milder = Finding("code", FOREVER.subject, Effect.REGEN_OFF, "2")
    found, causes = ([FOREVER], [milder], []), Causes()
    for tick, index in enumerate(order):
        causes.update(found[index], HOLD_NS, tick * 2 * HOLD_NS)
    causes.update([], HOLD_NS, 9 * HOLD_NS)
    assert causes.effects() == {Effect.REGEN_OFF}


def test_causes_count_each_for_itself_in_the_order_of_their_appearance():
    causes = Causes()
    causes.update([STOP], HOLD_NS, 0)
    causes.update([LIMIT], HOLD_NS, 500 * MS)  # the first tick without STOP
    assert [held.finding for held in causes.held] == [STOP, LIMIT]
    assert [held.finding for held in causes.having(BLOCKING)] == [STOP]
    assert [held.finding for held in causes.having(LIMITING)] == [LIMIT]
    causes.update([], HOLD_NS, 550 * MS)
    causes.update([], HOLD_NS, 1500 * MS)
    assert causes.effects() == {Effect.POWER_LIMIT}
    causes.update([], HOLD_NS, 1550 * MS)
    assert causes.effects() == frozenset()


def test_the_latest_value_of_a_cause_is_told_without_a_new_event():
    causes = Causes()
    causes.update([LIMIT], HOLD_NS, 0)
    later = Finding(LIMIT.cause, LIMIT.subject, LIMIT.effect, "1151 ms")
    assert causes.update([later], HOLD_NS, 50 * MS) == []
    assert causes.held[0].finding.detail == "1151 ms"
    assert causes.held[0].since_ns == 0


@pytest.mark.parametrize("effect", Effect)
def test_the_events_of_a_cause_carry_all_of_it(effect):
    causes, finding = Causes(), Finding("code", "a.b", effect, "2 (level2)")
    (began,) = causes.update([finding], HOLD_NS, 0)
    assert causes.update([], HOLD_NS, 1) == []
    (ended,) = causes.update([], HOLD_NS, 1 + HOLD_NS)
    fields = {"cause": "code", "subject": "a.b", "effect": effect.value, "detail": "2 (level2)"}
    assert (began.name, began.severity, began.fields) == ("cause_began", Severity.WARNING, fields)
    assert (ended.name, ended.severity, ended.fields) == ("cause_ended", Severity.INFO, fields)


def test_a_finding_reads_as_subject_value_and_effect():
    assert str(STOP) == "BMS_Status.CellUndervoltage 2 (level2): stop"
    assert str(Finding("foreign_sender", "command", Effect.STOP, "0008A7D0")) == (
        "command 0008A7D0: stop"
    )


def test_an_events_severity_is_the_level_of_pythons_logging():
    levels = logging.getLevelNamesMapping()
    assert all(severity == levels[severity.name] for severity in Severity)
