"""structlog, set up so that writing a line never waits for whoever reads it."""

import sys
import threading
from collections import deque
from typing import Literal, TextIO

import structlog

from vcu_gateway.core.events import Event, Severity

_QUEUE_LINES = 1000
_FLUSH_S = 1.0


log = structlog.get_logger()
"""The program's log: log.info("event_name", field=value)."""


class QueuedWriter:
    """A file-like object that hands lines to a writing thread and never blocks.

    Attributes:
        dropped: lines lost because the reader did not keep up, or there was none.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._lines: deque[str] = deque()
        self._wake = threading.Event()
        self._idle = threading.Event()
        self._idle.set()
        self.dropped = 0
        threading.Thread(target=self._work, name="log writer", daemon=True).start()

    def write(self, text: str) -> int:
        """Queue text; dropped and counted where the queue is full."""
        if len(self._lines) >= _QUEUE_LINES:
            self.dropped += 1
        else:
            self._lines.append(text)
            self._idle.clear()
            self._wake.set()
        return len(text)

    def flush(self) -> None:
        """Nothing waits here; see `drain`."""

    def drain(self) -> None:
        """Give the reader a moment to take what is queued, at the end of the program."""
        self._idle.wait(_FLUSH_S)

    def _work(self) -> None:
        while True:
            self._wake.wait()
            self._wake.clear()
            while self._lines:
                self._write_out(self._lines.popleft())
            self._idle.set()

    def _write_out(self, text: str) -> None:
        try:
            self._stream.write(text)
            self._stream.flush()
        except (OSError, ValueError):
            # Closed, full or gone: the program goes on without its log.
            self.dropped += 1


def configure(
    level: str, form: Literal["auto", "json", "console"], stream: TextIO | None = None
) -> QueuedWriter:
    """Set structlog up; JSON lines unless a person is looking."""
    stream = stream or sys.stderr
    person = form == "console" or (form == "auto" and _is_terminal(stream))
    writer = QueuedWriter(stream)
    renderer = (
        structlog.dev.ConsoleRenderer(colors=_is_terminal(stream))
        if person
        else structlog.processors.JSONRenderer()
    )
    structlog.configure(
        processors=[
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.WriteLoggerFactory(writer),  # type: ignore[arg-type]
    )
    return writer


def _is_terminal(stream: TextIO) -> bool:
    try:
        return stream.isatty()
    except ValueError:  # closed
        return False


def log_event(event: Event) -> None:
    """Write an event of the core as one line."""
    name = {
        Severity.INFO: "info",
        Severity.WARNING: "warning",
        Severity.ERROR: "error",
        Severity.CRITICAL: "critical",
    }[event.severity]
    getattr(log, name)(event.name, **event.fields)
