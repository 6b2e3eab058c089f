"""What happened: written to the log, and the latest of it kept, counted."""

import time
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime

from vcu_gateway.core.events import Event
from vcu_gateway.daemon.log import log_event

_ENTRIES = 200


@dataclass(slots=True)
class LoggedEvent:
    """One event with its fields, however often it happened; times are monotonic."""

    event: Event
    count: int
    first_ns: int
    last_ns: int
    last_wall_s: float

    def last_time(self) -> str:
        """Wall clock of the last one, ISO 8601, UTC."""
        return datetime.fromtimestamp(self.last_wall_s, UTC).isoformat(timespec="milliseconds")


class EventLog:
    """The latest events; an event that happens again with the same fields is counted.

    Belongs to the ticking thread.

    Attributes:
        forgotten: entries that made room for later ones.
    """

    def __init__(self) -> None:
        self._entries: OrderedDict[tuple[str, str], LoggedEvent] = OrderedDict()
        self.forgotten = 0

    def tell(self, event: Event) -> None:
        """Log an event and keep it."""
        log_event(event)
        key = (event.name, repr(sorted(event.fields.items())))
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
        """The latest so many, the latest last."""
        return list(self._entries.values())[-limit:]
