"""Event log: events handed to subscribers, and the latest kinds of them kept, counted."""

import time
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime

from vcu_gateway.core.causes import Event

_ENTRIES = 200

Sink = Callable[[Event], None]
"""Takes each event as it happens, on the ticking thread; it must neither wait nor raise."""


@dataclass(slots=True)
class LoggedEvent:
    """One event with its fields, counted; times of the monotonic clock in ns."""

    event: Event
    count: int
    first_ns: int
    last_ns: int
    last_wall_s: float

    def last_time(self) -> str:
        """Wall-clock time of the last one, ISO 8601, UTC."""
        return datetime.fromtimestamp(self.last_wall_s, UTC).isoformat(timespec="milliseconds")


class EventLog:
    """The latest events; one that happens again with the same severity and fields is counted.

    Belongs to the ticking thread.

    Attributes:
        forgotten: entries that made room for later ones.
    """

    def __init__(self) -> None:
        self._entries: OrderedDict[tuple[str, int, str], LoggedEvent] = OrderedDict()
        self._sinks: list[Sink] = []
        self.forgotten = 0

    def subscribe(self, sink: Sink) -> None:
        self._sinks.append(sink)

    def emit(self, event: Event) -> None:
        for sink in self._sinks:
            sink(event)
        key = (event.name, event.severity, repr(sorted(event.fields.items())))
        now_ns, wall_s = time.monotonic_ns(), time.time()
        entry = self._entries.get(key)
        if entry is None:
            self._entries[key] = LoggedEvent(event, 1, now_ns, now_ns, wall_s)
            self._make_room()
            return
        entry.count += 1
        entry.last_ns, entry.last_wall_s = now_ns, wall_s
        self._entries.move_to_end(key)

    def _make_room(self) -> None:
        if len(self._entries) > _ENTRIES:
            self._entries.popitem(last=False)
            self.forgotten += 1

    def latest(self, limit: int) -> Iterable[LoggedEvent]:
        """The latest `limit` entries, the latest last."""
        return list(self._entries.values())[-limit:]
