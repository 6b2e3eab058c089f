"""Text for people: durations, sizes, times, counts, tables, progress; the streams at the end."""

import contextlib
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TypeVar

from vcu_gateway.units import NS_PER_MS, NS_PER_S


def flush() -> None:
    """Flush stdout and stderr, or drop what cannot be written.

    Else Python tries it again after the last line of the program, fails and makes the exit code
    120 of whatever it was.
    """
    for stream in (sys.stdout, sys.stderr):
        if stream is None:  # closed before the program began
            continue
        try:
            stream.flush()
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)


_Item = TypeVar("_Item")

_MINUTE_MS = 60_000
_SIZES = ("kB", "MB", "GB", "TB")
_LOOK_EVERY = 8192
_PROGRESS_EVERY_S = 0.5

DATE_TIME = "%Y-%m-%d %H:%M:%S"
ISO_TIME = "%Y-%m-%dT%H:%M:%SZ"
ISO_TIME_MS = "%Y-%m-%dT%H:%M:%S.%fZ"
TIME_OF_DAY_MS = "%H:%M:%S.%f"


def duration(duration_ms: float | None) -> str:
    """`340 ms`, `3.2 s`, `12 min 04 s`, `26 h 05 min`; `never` for None."""
    if duration_ms is None or duration_ms < _MINUTE_MS:
        return _below_a_minute(duration_ms)
    minutes, seconds = divmod(round(duration_ms / 1000), 60)
    if minutes < 60:
        return f"{minutes} min {seconds:02} s"
    return f"{minutes // 60} h {minutes % 60:02} min"


def narrow_duration(duration_ms: float | None) -> str:
    """`340 ms`, `3.2 s`, `12:04`, `26:05:12` as it goes on, for columns; `never` for None."""
    if duration_ms is None or duration_ms < _MINUTE_MS:
        return _below_a_minute(duration_ms)
    minutes, seconds = divmod(int(duration_ms / 1000), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"


def _below_a_minute(duration_ms: float | None) -> str:
    if duration_ms is None:
        return "never"
    return f"{duration_ms:.0f} ms" if duration_ms < 1000 else f"{duration_ms / 1000:.1f} s"


def size(size_bytes: float) -> str:
    """Bytes with three digits and a unit, as disks are sold: 1 MB is 1,000,000 bytes."""
    if size_bytes < 1000:
        return f"{size_bytes:.0f} B"
    power = min(len(_SIZES), int(math.log(size_bytes * 1.0005, 1000)))
    return f"{size_bytes / 1000**power:.3g} {_SIZES[power - 1]}"


def utc(wall_ns: int, form: str = DATE_TIME) -> str:
    """Instant in UTC; `form` as for time.strftime, with %f for the milliseconds."""
    seconds, rest_ns = divmod(wall_ns, NS_PER_S)
    form = form.replace("%f", f"{rest_ns // NS_PER_MS:03}")
    return time.strftime(form, time.gmtime(seconds))


def counted(count: int, what: str) -> str:
    """`1 tick`, `1,200 ticks`."""
    return f"{count:,} {what}{'' if count == 1 else 's'}"


def table(rows: Iterable[Sequence[str]], right: Sequence[int] = (), indent: str = "") -> list[str]:
    """Lines with every column as wide as its widest cell; `right` are columns of numbers."""
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        indent
        + "  ".join(
            cell.rjust(width) if column in right else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def say(sentence: object) -> None:
    """Print a sentence or a Problem on stderr, also where nobody reads that any more."""
    if sys.stderr is not None:
        with contextlib.suppress(OSError, ValueError):
            _put(f"{sentence}\n")


def _put(text: str) -> None:
    sys.stderr.write(text)
    sys.stderr.flush()


class Progress:
    """Line of progress on stderr: a new one every 0.5 s, none where no person waits there.

    Attributes:
        shown: stderr is a terminal, and the line is wanted.
    """

    def __init__(self, *, wanted: bool = True) -> None:
        self.shown = wanted and sys.stderr is not None and sys.stderr.isatty()
        self._next_s = time.monotonic() + _PROGRESS_EVERY_S

    def show(self, line: str) -> None:
        """Show a line in place of the one before, where it is time for one."""
        if self.shown and time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + _PROGRESS_EVERY_S
            _put(f"\r\033[K{line} ")

    def show_frames(self, share: float | None, frames: int) -> None:
        """Show how much of a file is read, 0 to 1, and how many frames came; None: not known."""
        self.show(f"{'' if share is None else f'{share:4.0%}, '}{frames} frames")

    def clear(self) -> None:
        if self.shown:
            _put("\r\033[K")

    def over(self, items: Iterable[_Item], show: Callable[[int], None]) -> Iterator[_Item]:
        """The items; `show` is called with their number so far now and then."""
        if not self.shown:
            yield from items
            return
        for count, item in enumerate(items, 1):
            if count % _LOOK_EVERY == 0:
                show(count)
            yield item
        self.clear()
