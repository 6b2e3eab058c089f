"""Events of the page: who signed in and who asked for what, in the journal and in the browser."""

import contextlib
import json
import sys
from collections import deque
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any, Literal, TypedDict

_KEPT = 200

Severity = Literal["info", "warning", "error"]


class WebEvent(TypedDict):
    """One event, as the gateway's own are shown."""

    name: str
    severity: Severity
    fields: dict[str, Any]
    time: str


def _write_to_stderr(line: str) -> None:
    with contextlib.suppress(OSError, ValueError):  # nobody reads it any more
        sys.stderr.write(line)
        sys.stderr.flush()


class WebEvents:
    """The latest 200 events; each is a line of JSON, too, by default on stderr.

    `on_change` is called after each.
    """

    def __init__(self, write: Callable[[str], None] = _write_to_stderr) -> None:
        self._write = write
        self._events: deque[WebEvent] = deque(maxlen=_KEPT)
        self.on_change: Callable[[], None] = lambda: None

    def tell(self, name: str, severity: Severity, **fields: object) -> None:
        time = datetime.now(UTC).isoformat(timespec="milliseconds")
        event: WebEvent = {"name": name, "severity": severity, "fields": fields, "time": time}
        self._events.append(event)
        line = {"event": name, "level": severity, "timestamp": time, **fields}
        self._write(json.dumps(line, ensure_ascii=False, default=str) + "\n")
        self.on_change()

    def latest(self) -> list[WebEvent]:
        """The newest last."""
        return list(self._events)
