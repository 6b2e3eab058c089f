"""Log of the program: structlog over a queue, so that writing a line never waits for a reader."""

import os
import queue
import select
import sys
import threading
import traceback
from collections.abc import Callable
from typing import Any, Literal, TextIO

from vcu_gateway.core.causes import Event
from vcu_gateway.lean_imports import hidden, put_off

# structlog imports these where they are installed, for tracebacks and threads that are not here.
with hidden("rich", "better_exceptions", "twisted", "greenlet"), put_off("asyncio"):
    import structlog

_QUEUE_LINES = 1000
_LINE_CHARACTERS = 16_384
# The end of the program waits no longer than this for a reader that does not read.
_DRAIN_S = 0.2

# syslog's.
_PRIORITIES = {"debug": 7, "info": 6, "warning": 4, "error": 3, "critical": 2}

log = structlog.get_logger()
"""The program's log: log.info("event_name", field=value)."""


class QueuedWriter:
    """A file-like object that hands lines to a writing thread and never blocks.

    It writes to a descriptor of its own: nothing else closes that one, and no lock of the stream's
    is held while a reader keeps it waiting, which would stop the interpreter's end.

    `report_lost` is called, on the writing thread, with the number of lines that were lost, once
    the reader takes lines again.
    """

    def __init__(
        self, stream: TextIO | None, report_lost: Callable[[int], None] = lambda _: None
    ) -> None:
        self._put_out = _sink(stream)
        self._report_lost = report_lost
        self._queue: queue.SimpleQueue[str | threading.Event] = queue.SimpleQueue()
        self._refused = self._failed = self._reported = 0
        self._reader_reads = False
        threading.Thread(target=self._work, name="log writer", daemon=True).start()

    @property
    def dropped(self) -> int:
        """Lines lost because the reader did not keep up, or there was none."""
        return self._refused + self._failed

    def write(self, text: str) -> int:
        """Queue text; dropped and counted where the queue is full."""
        if self._queue.qsize() >= _QUEUE_LINES:
            self._refused += 1
        elif len(text) > _LINE_CHARACTERS:
            self._queue.put(f"{text[:_LINE_CHARACTERS]} ...\n")
        else:
            self._queue.put(text)
        return len(text)

    def flush(self) -> None:
        """Nothing: the writing thread flushes; see `drain`."""

    def drain(self) -> None:
        """Wait at most 0.2 s for the queued lines to be written, at the end of the program."""
        written = threading.Event()
        self._queue.put(written)
        written.wait(_DRAIN_S)

    def _work(self) -> None:
        while True:
            work = self._queue.get()
            if isinstance(work, str):
                self._write_out(work)
                if self._queue.empty():
                    self._report_lost_lines()
            elif self._report_lost_lines():
                self._queue.put(work)  # the line about the loss comes before
            else:
                work.set()

    def _write_out(self, text: str) -> None:
        try:
            self._put_out(text)
            self._reader_reads = True
        except (OSError, ValueError):
            # Closed, full or gone: the program goes on without its log.
            self._failed += 1
            self._reader_reads = False

    def _report_lost_lines(self) -> bool:
        """Report newly lost lines while the reader takes lines; True where there were any."""
        lost = self.dropped - self._reported
        if not lost or not self._reader_reads:
            return False
        self._reported += lost
        self._report_lost(lost)
        return True


def _sink(stream: TextIO | None) -> Callable[[str], object]:
    """Function that writes a text, however long it takes; it raises OSError or ValueError."""
    if stream is None:  # closed before the program began: each line fails and is counted
        return _Descriptor(-1).write
    try:
        return _Descriptor(os.dup(stream.fileno())).write
    except (OSError, ValueError):  # closed, or in memory
        return stream.write


class _Descriptor:
    """Writes whole lines to a descriptor, to a non-blocking one too."""

    def __init__(self, number: int) -> None:
        self._number = number
        self._torn = False

    def write(self, text: str) -> None:
        left = text.encode("utf-8", "backslashreplace")
        if self._torn:
            left = b"\n" + left
        while left:
            written = self._write_some(left)
            left = left[written:]
            self._torn = bool(left)

    def _write_some(self, data: bytes) -> int:
        try:
            return os.write(self._number, data)
        except BlockingIOError:
            poll = select.poll()
            poll.register(self._number, select.POLLOUT)
            poll.poll()
            return 0


def configure(
    level: str, form: Literal["auto", "json", "console"], stream: TextIO | None = None
) -> QueuedWriter:
    """Set structlog up: JSON lines, or coloured text on a terminal.

    Without a stream the log is the program's own: it goes to stderr, and crashes go into it.
    """
    own, stream = stream is None, stream or sys.stderr
    on_terminal = stream is not None and not stream.closed and stream.isatty()
    writer = QueuedWriter(stream, lambda lines: log.warning("log_lines_dropped", lines=lines))
    render: structlog.typing.Processor = structlog.processors.JSONRenderer()
    if form == "console" or (form == "auto" and on_terminal):
        render = structlog.dev.ConsoleRenderer(colors=on_terminal)
    if _is_journal(stream, os.environ.get("JOURNAL_STREAM", "")):
        render = _for_the_journal(render)
    add_time = structlog.processors.TimeStamper(fmt="iso", utc=True)
    structlog.configure(
        processors=[structlog.processors.add_log_level, add_time, render],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=structlog.WriteLoggerFactory(writer),  # type: ignore[arg-type]
    )
    if own:
        _log_crashes(writer)
    return writer


def _is_journal(stream: TextIO | None, journal_stream: str) -> bool:
    """Whether this stream leads to the journal; `journal_stream` is systemd's DEVICE:INODE."""
    try:
        status = None if stream is None else os.fstat(stream.fileno())
    except (OSError, ValueError):  # closed, or in memory
        return False
    return status is not None and journal_stream == f"{status.st_dev}:{status.st_ino}"


def _for_the_journal(render: structlog.typing.Processor) -> structlog.typing.Processor:
    """Renderer that puts `<priority>` before each line, which the journal takes off."""

    def rendered(logger: Any, name: str, fields: structlog.typing.EventDict) -> str:
        priority = _PRIORITIES.get(fields.get("level", ""), _PRIORITIES["info"])
        return f"<{priority}>{render(logger, name, fields)!s}"

    return rendered


def _log_crashes(writer: QueuedWriter) -> None:
    """Log uncaught exceptions of every thread.

    Python's own hooks write to stderr and wait for its reader: a crashed program would not end.
    """

    def of_thread(crash: threading.ExceptHookArgs) -> None:
        _log_crash(crash.thread.name if crash.thread else "unknown", *crash[:3])

    def of_main(*crash: Any) -> None:
        _log_crash("main", *crash)
        writer.drain()

    threading.excepthook = of_thread
    sys.excepthook = of_main


def _log_crash(thread: str, kind: Any, error: Any, trace: Any) -> None:
    lines = traceback.format_exception(kind, error, trace)
    log.critical("crashed", thread=thread, error=repr(error), exception="".join(lines))


def log_event(event: Event) -> None:
    log.log(event.severity, event.name, **event.fields)
