"""Report of a recording as values, its lines on a common grid and as bytes; not how it is drawn.

Lines of a plot on a common grid: of each bucket the earlier and the later of its extremes.

So a peak of one frame stays visible however far an hour is drawn together, and a line has two
points a bucket however many frames there were.
"""

import sys
import zlib
from array import array
from collections.abc import Iterable, Mapping, Sequence
from enum import Enum
from itertools import groupby, pairwise
from typing import Any, NamedTuple

from vcu_gateway.export.curve_figure import CurveFigure

GAP = -(1 << 31)
"""Stands for a bucket without a value."""

LARGEST_CODE = (1 << 31) - 1


class CodeLine(NamedTuple):
    """Extremes of each bucket in the order in which they came; GAP where there is none."""

    earlier: "array[int]"
    later: "array[int]"

    @property
    def constant(self) -> int | None:
        """The only code of the line; None where there are several, or none at all."""
        codes = {*self.earlier, *self.later} - {GAP}
        return codes.pop() if len(codes) == 1 else None

    @property
    def empty(self) -> bool:
        return max(self.later, default=GAP) == GAP

    def halved(self) -> "CodeLine":
        """The same on a grid of twice the width."""
        if len(self.later) % 2:
            self.earlier.append(GAP)
            self.later.append(GAP)
        pairs = zip(
            self.earlier[::2], self.later[::2], self.earlier[1::2], self.later[1::2], strict=True
        )
        merged = [_merged(*four) for four in pairs]
        return CodeLine(array("i", [a for a, _ in merged]), array("i", [b for _, b in merged]))


def _merged(first: int, second: int, third: int, fourth: int) -> tuple[int, int]:
    """Extremes of two buckets, in their order."""
    if third == GAP or first == GAP:
        return (first, second) if third == GAP else (third, fourth)
    if first == second == third == fourth:
        return first, first
    four = (first, second, third, fourth)
    low, high = min(four), max(four)
    return (low, high) if four.index(low) < four.index(high) else (high, low)


class LineBuilder:
    """Gathers the codes of one signal; the stamps may only rise."""

    def __init__(self, buckets: int) -> None:
        self._earlier = array("i", [GAP]) * buckets
        self._later = array("i", [GAP]) * buckets
        self._bucket = -1

    def add(self, buckets: Iterable[int], codes: Iterable[int]) -> None:
        """Take in codes, each with the number of its bucket."""
        earlier, later, current = self._earlier, self._later, self._bucket
        for bucket, code in zip(buckets, codes, strict=True):
            if bucket > current:
                earlier[bucket] = later[bucket] = code
                current = bucket
                continue
            before, after = earlier[current], later[current]
            if before <= code <= after or after <= code <= before:
                continue
            if (code < before) == (before < after):  # it takes the earlier one's place
                earlier[current] = after
            later[current] = code
        self._bucket = current

    def line(self, hold_buckets: int) -> CodeLine:
        """The line; a value is held for so many buckets without a new one."""
        earlier, later = self._earlier, self._later
        held, since = GAP, 0
        for bucket, code in enumerate(later):
            if code != GAP:
                held, since = code, bucket
            elif held != GAP and bucket - since <= hold_buckets:
                earlier[bucket] = later[bucket] = held
        return CodeLine(earlier, later)


_SMALL = range(-(1 << 15), 1 << 15)
_LEVEL = 6


class PackedLines(NamedTuple):
    """Lines, packed.

    Attributes:
        data: deflated bytes of all lines, one behind the other.
        layouts: of each line: width of its numbers in bytes, whether it has two for each bucket,
            its first code, and its gaps as (first point, points).
    """

    data: bytes
    layouts: tuple[dict[str, Any], ...]


def packed(lines: Sequence[CodeLine]) -> PackedLines:
    deflate = zlib.compressobj(_LEVEL, zlib.DEFLATED, zlib.MAX_WBITS)
    pieces, layouts = [], []
    for line in lines:
        layout, data = _packed(line)
        layouts.append(layout)
        pieces.append(deflate.compress(data))
    pieces.append(deflate.flush())
    return PackedLines(b"".join(pieces), tuple(layouts))


def _packed(line: CodeLine) -> tuple[dict[str, Any], bytes]:
    double = line.earlier != line.later
    points = array("i", line.later)
    if double:
        points = array("i", bytes(8 * len(points)))
        points[::2], points[1::2] = line.earlier, line.later
    gaps = _gaps(points)
    filled = _filled(points, gaps)
    differences = [after - before for before, after in pairwise(filled)]
    small = min(differences, default=0) in _SMALL and max(differences, default=0) in _SMALL
    numbers = array("h" if small else "q", differences)
    if sys.byteorder == "big":
        numbers.byteswap()
    raw = numbers.tobytes()
    width = numbers.itemsize
    layout = {"w": width, "d": double, "a": filled[0], "g": gaps}
    return layout, b"".join(raw[place::width] for place in range(width))


def _gaps(points: "array[int]") -> list[list[int]]:
    """First point and number of points of each gap."""
    gaps: list[list[int]] = []
    place = 0
    if GAP not in points:
        return gaps
    for is_gap, group in groupby(points, key=GAP.__eq__):
        count = sum(1 for _ in group)
        if is_gap:
            gaps.append([place, count])
        place += count
    return gaps


def _filled(points: "array[int]", gaps: list[list[int]]) -> "array[int]":
    """The points, each gap filled with the code before it, the first one with that behind it."""
    for first, count in gaps:
        last = first + count
        code = points[first - 1] if first else points[last] if last < len(points) else 0
        points[first:last] = array("i", [code]) * count
    return points


class Role(Enum):
    """Role of a line in its plot."""

    COMMANDED = "commanded"
    ACTUAL = "actual"
    WHAT_IF = "what if"
    SIGNAL = "signal"


class Line(NamedTuple):
    """One line of a plot: raw codes, of which physical = code * factor + offset.

    Attributes:
        steps: held from each value to the next, not joined by slopes.
    """

    label: str
    role: Role
    codes: CodeLine
    factor: float = 1.0
    offset: float = 0.0
    names: Mapping[int, str] = {}
    steps: bool = False


class Plot(NamedTuple):
    """Lines of one unit over time."""

    title: str
    unit: str
    lines: tuple[Line, ...]


class Span(NamedTuple):
    """Stretch of a band; `kind` is a mode, an effect, or empty."""

    begin_ns: int
    end_ns: int
    kind: str
    text: str


class Band(NamedTuple):
    """Row of stretches above the plots."""

    title: str
    spans: tuple[Span, ...]
    what_if: bool = False


class ReportEvent(NamedTuple):
    """Row of the table of events; `severity` is a level of the log."""

    wall_ns: int
    severity: str
    name: str
    text: str


class Overlay(NamedTuple):
    """Answer of a replay with another configuration, laid over a recording.

    Attributes:
        headline: what would have been different, in a sentence.
        notes: further sentences, such as that the recorded vehicle does not react.
        columns, rows: table of what differs, as texts.
        times_ns: wall time of each tick.
        series: "VCU_PCU1_Command.Throttle" -> value at each tick, NaN where no frame was sent.
        modes: wall time and the mode from there on.
        causes: text, begin and end of each; the end is None where it counts at the end.
        curves: both curves of each, with the places where the drive was.
    """

    headline: str
    notes: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    times_ns: Sequence[int] = ()
    series: Mapping[str, Sequence[float]] = {}
    modes: Sequence[tuple[int, str]] = ()
    causes: Sequence[tuple[str, int, int | None]] = ()
    curves: Sequence[CurveFigure] = ()


class Report(NamedTuple):
    """Everything that a page shows.

    Attributes:
        headline: the drive in a sentence.
        facts: name and value, the most important first.
        bucket_ns, buckets: the grid of every line.
        constant: signals that never changed, and their value.
        texts: attached files, by name.
    """

    title: str
    headline: str
    facts: tuple[tuple[str, str], ...]
    start_ns: int
    end_ns: int
    bucket_ns: int
    buckets: int
    plots: tuple[Plot, ...]
    bands: tuple[Band, ...]
    events: tuple[ReportEvent, ...]
    whys: tuple[tuple[int, str], ...]
    constant: tuple[tuple[str, str], ...]
    texts: Mapping[str, str]
    overlay: Overlay | None = None
