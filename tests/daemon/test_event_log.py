"""The latest events, counted, and never more than fit."""

from datetime import datetime

from vcu_gateway.core.events import Event, Severity
from vcu_gateway.daemon.event_log import EventLog


def event(name: str = "link_lost", **fields: object) -> Event:
    return Event(name, Severity.ERROR, fields)


def test_an_event_that_happens_again_is_counted_and_moves_to_the_end():
    journal = EventLog()
    for one in (event(reason="a"), event(reason="b"), event(reason="a")):
        journal.tell(one)
    found = [(entry.event.fields["reason"], entry.count) for entry in journal.latest(10)]
    assert found == [("b", 1), ("a", 2)]
    last = journal.latest(1)[0]
    assert last.first_ns < last.last_ns
    assert datetime.fromisoformat(last.last_time()).tzinfo is not None


def test_the_order_of_the_fields_does_not_matter():
    journal = EventLog()
    journal.tell(event(a=1, b=2))
    journal.tell(event(b=2, a=1))
    assert [entry.count for entry in journal.latest(10)] == [2]


def test_only_so_many_are_kept_and_the_rest_is_counted():
    journal = EventLog()
    for number in range(203):
        journal.tell(event(number=number))
    kept = [entry.event.fields["number"] for entry in journal.latest(1000)]
    assert kept == list(range(3, 203))
    assert journal.forgotten == 3
