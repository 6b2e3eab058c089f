"""Part of a recording that is exported: `--from` and `--to`."""

import re
from datetime import UTC, datetime
from typing import NamedTuple

from vcu_gateway.units import NS_PER_S

_DAY_S = 86_400
_SECONDS = re.compile(r"(\d+(?:\.\d{1,9})?)\s*s?", re.ASCII)
_CLOCK = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2}(?:\.\d{1,9})?))?", re.ASCII)


class Moment(NamedTuple):
    """Moment of a recording as somebody wrote it.

    Attributes:
        ns: since the recording's beginning, since midnight (UTC), or since 1970.
        kind: "since start", "time of day" or "date".
    """

    ns: int
    kind: str

    def wall_ns(self, start_ns: int) -> int:
        """Moment on the recording's clock; a time of day is the first one from its start on."""
        if self.kind == "date":
            return self.ns
        if self.kind == "since start":
            return start_ns + self.ns
        midnight_ns = start_ns - start_ns % (_DAY_S * NS_PER_S)
        # A second of grace: the start itself, written without its fraction.
        later = midnight_ns + self.ns < start_ns - NS_PER_S
        return midnight_ns + self.ns + later * _DAY_S * NS_PER_S


def moment(text: str) -> Moment:
    """`90`, `90.5 s`, `12:03:14.150` or `2026-11-23T12:03:14` (UTC); ValueError for others."""
    if found := _SECONDS.fullmatch(text.strip()):
        return Moment(_ns(found[1]), "since start")
    if found := _CLOCK.fullmatch(text.strip()):
        hours, minutes, seconds = int(found[1]), int(found[2]), _ns(found[3] or "0")
        if hours > 23 or minutes > 59 or seconds >= 60 * NS_PER_S:
            raise ValueError(f"{text} is no time of day")
        return Moment((hours * 3600 + minutes * 60) * NS_PER_S + seconds, "time of day")
    day, fraction, zone = re.fullmatch(r"(.*?)(\.\d{1,9})?(Z?)", text.strip()).groups("")  # type: ignore[union-attr]
    date = datetime.fromisoformat(day)
    date = date.replace(tzinfo=UTC) if date.tzinfo is None or zone else date
    return Moment(int(date.timestamp()) * NS_PER_S + _ns(f"0{fraction}"), "date")


def _ns(seconds: str) -> int:
    whole, _, fraction = seconds.partition(".")
    return int(whole) * NS_PER_S + int(f"{fraction:0<9}")


class Window:
    """Window of time; open where a moment is None, and known after the first stamp."""

    def __init__(self, begin: Moment | None = None, end: Moment | None = None) -> None:
        self._begin, self._end = begin, end
        self.open = begin is None and end is None
        self._bounds_ns: tuple[int, int] | None = None

    def bounds_ns(self, start_ns: int) -> tuple[int, int]:
        """First and last stamp inside; `start_ns` counts in the first call only."""
        if self._bounds_ns is None:
            begin_ns = self._begin.wall_ns(start_ns) if self._begin else -(1 << 63)
            end_ns = self._end.wall_ns(start_ns) if self._end else (1 << 63) - 1
            self._bounds_ns = begin_ns, end_ns
        return self._bounds_ns

    def holds(self, stamp_ns: int) -> bool:
        """Whether a stamp lies inside; the first one that is asked about is the start."""
        if self.open:
            return True
        begin_ns, end_ns = self.bounds_ns(stamp_ns)
        return begin_ns <= stamp_ns <= end_ns
