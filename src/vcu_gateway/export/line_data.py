"""Lines of a report as bytes: differences, low bytes before high ones, deflated together."""

import sys
import zlib
from array import array
from collections.abc import Sequence
from itertools import groupby, pairwise
from typing import Any, NamedTuple

from vcu_gateway.export.lines import GAP, CodeLine

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
