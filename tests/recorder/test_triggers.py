"""Lines that must not wait for the disk, and reasons of incidents."""

import json
import re

import pytest

from vcu_gateway.recorder.triggers import Noticed, Trigger, noticed

LATCHED = ["fault_latched", "critical", {"reason": "BMS undervoltage 2: stop"}]


def tick(*events, **more):
    return (json.dumps({"f": 1, "tick": 5, **more, "events": list(events)}) + "\n").encode()


def test_an_ordinary_tick_may_wait():
    assert noticed(b'{"f":9,"tick":1,"frames":[],"ok":[]}\n') == Noticed(False, ())


def test_an_event_that_is_none_of_the_reasons_may_wait():
    assert noticed(tick(["demand_owner", "info", {}])) == Noticed(False, ())


def test_a_mode_change_may_not_wait_and_is_no_incident():
    assert noticed(b'{"f":9,"tick":1,"mode":"active"}\n') == Noticed(True, ())


def test_a_latched_fault_is_named_by_the_cause_that_stops():
    limiting = ["cause_began", "warning", {"cause": "warm", "effect": "power limit"}]
    stopping = ["cause_began", "warning", {"cause": "undervoltage", "effect": "stop"}]
    (trigger,) = noticed(tick(limiting, stopping, LATCHED)).triggers
    assert trigger == Trigger(
        "fault_latched", "undervoltage", "fault latched: BMS undervoltage 2: stop"
    )


def test_a_code_is_named_by_its_signal():
    fields = {"cause": "code", "subject": "BMS_Status.CellUndervoltage", "effect": "cut"}
    (trigger,) = noticed(tick(["cause_began", "warning", fields], LATCHED)).triggers
    assert trigger.kind == "CellUndervoltage"


def test_a_latched_fault_without_a_cause_is_named_by_its_words_without_values():
    (trigger,) = noticed(tick(LATCHED)).triggers
    assert trigger.kind == "bms_undervoltage"


def test_a_fault_that_was_latched_before_this_start_keeps_its_kind():
    stale = ["cause_began", "critical", {"cause": "stale", "effect": "cut"}]
    kept = "before this start: emergency stop requested: cut"
    (trigger,) = noticed(tick(stale, ["fault_latched", "critical", {"reason": kept}])).triggers
    assert trigger.kind == "emergency_stop"


@pytest.mark.parametrize("cause", ["x" * 300, "../../etc", "a\0b", "\ud800", ""])
def test_a_kind_can_be_the_name_of_a_folder_whatever_the_cause_is(cause):
    began = ["cause_began", "critical", {"cause": cause, "effect": "cut"}]
    (trigger,) = noticed(tick(began, LATCHED)).triggers
    assert re.fullmatch(r"[0-9A-Za-z_-]{1,40}", trigger.kind)


def test_an_emergency_stop_is_one_even_where_a_fault_was_latched_before():
    (trigger,) = noticed(b'{"f":0,"estop":true,"granted":true}\n').triggers
    assert trigger.reason == trigger.kind == "emergency_stop"


@pytest.mark.parametrize(("count", "expected"), [(0, 0), (1, 1), (3, 1)])
def test_only_an_unexpected_restart_is_one(count, expected):
    found = noticed(b'{"f":0,"restarted":%d}\n' % count)
    assert len(found.triggers) == expected
    assert found.urgent == bool(expected)


@pytest.mark.parametrize(
    "line",
    [
        b'{"f":0,"estop":\n',
        b'["estop":]\n',
        b'"estop": 1\n',
        b'{"f":1,"events":[1,[2],["fault_latched","x",3]]}\n',
        b'{"f":1,"events":{"a":1}}\n',
        b'{"f":1,"events":5}\n',
        b'{"f":1,"events":[["cause_began","x",7]]}\n',
        b'{"checkpoint":{"estop":true},"f":0}\n',
    ],
)
def test_damaged_lines_and_checkpoints_are_no_reasons(line):
    assert noticed(line).triggers == ()
