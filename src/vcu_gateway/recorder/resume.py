"""How far a drive is recorded: read from its last segments, after a recorder ended."""

import re
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.recording import chain, layout
from vcu_gateway.recording.members import NO_LINK, whole_members
from vcu_gateway.recording.segment import Losses, read_begin

_TICK = re.compile(rb'^\{"f":\d+,"tick":', re.MULTILINE)


class Position(NamedTuple):
    """How many frames and ticks of a run came before; recorded ones and lost ones."""

    frames: int = 0
    ticks: int = 0


class Recorded(NamedTuple):
    """A drive's end on the disk; `link`: what its next member names."""

    position: Position
    lost: Losses
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
        frames += sum(member.lines for member in whole_members(segment.frames))
        ticks += sum(ticks_of(member.data) for member in whole_members(segment.core))
        begin = read_begin(segment.core)
        if begin is not None:
            position = Position(begin.frames + frames, begin.ticks + ticks)
            return Recorded(position, begin.lost, next_segment, link)
    return Recorded(Position(frames, ticks), Losses(), next_segment, link)
