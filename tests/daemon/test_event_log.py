"""The latest events, counted, and never more than fit."""

from datetime import datetime
from typing import Any

from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.daemon.events import EventLog


def event(name: str = "link_lost", **fields: Any) -> Event:
    return Event(name, Severity.ERROR, fields)


def test_an_event_that_happens_again_is_counted_and_moves_to_the_end():
    event_log = EventLog()
    for one in (event(reason="a"), event(reason="b"), event(reason="a")):
        event_log.emit(one)
    found = [(entry.event.fields["reason"], entry.count) for entry in event_log.latest(10)]
    assert found == [("b", 1), ("a", 2)]
    (last,) = event_log.latest(1)
    assert last.first_ns < last.last_ns
    assert datetime.fromisoformat(last.last_time()).tzinfo is not None


def test_the_order_of_the_fields_does_not_matter():
    event_log = EventLog()
    event_log.emit(event(a=1, b=2))
    event_log.emit(event(b=2, a=1))
    assert [entry.count for entry in event_log.latest(10)] == [2]


def test_only_so_many_are_kept_and_the_rest_is_counted():
    event_log = EventLog()
    for number in range(203):
        event_log.emit(event(number=number))
    kept = [entry.event.fields["number"] for entry in event_log.latest(1000)]
    assert kept == list(range(3, 203))
    assert event_log.forgotten == 3


def test_every_subscriber_is_handed_each_event_and_none_from_before():
    event_log, first, second = EventLog(), [], []
    event_log.emit(event(number=0))
    event_log.subscribe(first.append)
    event_log.emit(event(number=1))
    event_log.subscribe(second.append)
    event_log.emit(event(number=1))
    assert [one.fields["number"] for one in first] == [1, 1]
    assert [one.fields["number"] for one in second] == [1]
