"""The recorder's own lines of a segment: how it begins, what is missing before it, how it ends."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.drive_format.members import Member, MemberDamage, read_members

_LINES_OF_BEGIN = 4


class Losses(NamedTuple):
    """What a gateway handed on and no file holds, told by gaps."""

    frames: int = 0
    ticks: int = 0
    gaps: int = 0

    def __add__(self, other: object) -> "Losses":
        """Both together."""
        if not isinstance(other, Losses):
            return NotImplemented
        return Losses(*(one + two for one, two in zip(self, other, strict=True)))


class SegmentBegin(NamedTuple):
    """Begin of a segment.

    Attributes:
        frames, ticks: that the gateway had handed on before it, since its start.
        wall_ns: when it began.
        lost: of the whole drive up to here.
        gap: of these, what is missing right before this segment.
    """

    frames: int
    ticks: int
    wall_ns: int
    lost: Losses
    gap: Losses


class CoreLineError(ValueError):
    """A core line is not one of this format; the text says why."""


def parsed_line(line: bytes) -> dict[str, Any]:
    """A core line as its object; CoreLineError where it is none."""
    try:
        found = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise CoreLineError(f"is no JSON: {error}") from error
    if not isinstance(found, dict) or not isinstance(found.get("f"), int):
        raise CoreLineError("has no number of frames before it")
    return found


def read_begin(core: Path) -> SegmentBegin | None:
    """The begin of a segment by its first member; None where it is damaged."""
    first = next(read_members(core), None)
    if not isinstance(first, Member):
        return None
    lines = first.data.split(b"\n", _LINES_OF_BEGIN)[:_LINES_OF_BEGIN]
    try:
        return begin_of([parsed_line(line) for line in lines if line])
    except CoreLineError:
        return None


def begin_of(lines: list[dict[str, Any]]) -> SegmentBegin | None:
    """The begin that stands in the first lines of a segment; CoreLineError where it is wrong."""
    begin = next((line["begin"] for line in lines if "begin" in line), None)
    gaps = [line["gap"] for line in lines if "gap" in line]
    if begin is None:
        return None
    try:
        gap = sum((Losses(one["frames"] or 0, one["ticks"] or 0, 1) for one in gaps), Losses())
        told = Losses(**begin["lost"])
        return SegmentBegin(begin["frames"], begin["ticks"], begin["wall_ns"], told, gap)
    except (KeyError, TypeError) as error:
        raise CoreLineError(f"has no usable begin or gap: {error}") from error


def last_second(path: Path) -> int | None:
    """When the last readable lines of a file were gathered, seconds since 1970."""
    seconds = [part.wall_s for part in members_of(path) if part.wall_s]
    return max(seconds, default=None)


def members_of(path: Path) -> Iterator[Member]:
    """The readable members."""
    return (part for part in read_members(path) if not isinstance(part, MemberDamage))
