"""How far a drive is recorded: read from its last segments, after a recorder ended."""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.drive_format import chain, layout
from vcu_gateway.drive_format.layout import SegmentFiles
from vcu_gateway.drive_format.members import NO_LINK, Member, read_members

_TICK = re.compile(rb'^\{"f":\d+,"tick":', re.MULTILINE)


class Position(NamedTuple):
    """How many frames and ticks of a run came before; recorded ones and lost ones."""

    frames: int = 0
    ticks: int = 0


class Lost(NamedTuple):
    """What is missing in a drive, all gaps together."""

    frames: int = 0
    ticks: int = 0
    gaps: int = 0

    def with_gap(self, frames: int, ticks: int) -> "Lost":
        return Lost(self.frames + frames, self.ticks + ticks, self.gaps + 1)


class Recorded(NamedTuple):
    """A drive's end on the disk; `link`: what its next member names."""

    position: Position
    lost: Lost
    next_segment: int
    link: bytes


def ticks_of(core_lines: bytes) -> int:
    return sum(1 for _ in _TICK.finditer(core_lines))


def recorded(folder: Path) -> Recorded:
    """How far this drive is recorded; OSError where it cannot be read."""
    segments = layout.segments(folder)
    next_segment = segments[-1].number + 1 if segments else 1
    end = chain.end(folder)
    link = (end and end.member.digest) or NO_LINK
    frames = ticks = 0
    for segment in reversed(segments):
        frames += sum(member.lines for member in _members(segment.frames))
        ticks += sum(ticks_of(member.data) for member in _members(segment.core))
        begin = _begin(segment)
        if begin is not None:
            position = Position(begin["frames"] + frames, begin["ticks"] + ticks)
            return Recorded(position, _lost(begin), next_segment, link)
    return Recorded(Position(frames, ticks), Lost(), next_segment, link)


def _members(path: Path | None) -> Iterator[Member]:
    if path is not None:
        yield from (part for part in read_members(path) if isinstance(part, Member))


def _begin(segment: SegmentFiles) -> Mapping[str, Any] | None:
    """What the segment's second line says; None where it cannot be read."""
    first = next(_members(segment.core), None)
    lines = first.data.split(b"\n", 2) if first is not None and first.first_line == 0 else []
    try:
        begin = json.loads(lines[1])["begin"]
        return begin if isinstance(begin["frames"] + begin["ticks"], int) else None
    except (ValueError, KeyError, IndexError, TypeError, RecursionError):
        return None


def _lost(begin: Mapping[str, Any]) -> Lost:
    lost = begin.get("lost")
    counts = [lost.get(key) if isinstance(lost, dict) else 0 for key in Lost._fields]
    return Lost(*(count if isinstance(count, int) else 0 for count in counts))
