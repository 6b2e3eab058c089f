"""The recorder's own lines of a segment: how it begins, what is missing before it, how it ends."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.drive_format.members import Member, MemberDamage, read_members

_LINES_OF_BEGIN = 4
MAX_LINE_BYTES = 1 << 22
"""Of a core line; a longer one is damage, or an attack on the reader's memory."""
_GOES_ON = "the next segment begins"
_NUMBERS = range(1 << 63)
"""What counters and stamps can be."""


class Losses(NamedTuple):
    """What a gateway handed on and no file holds, told by gaps."""

    frames: int = 0
    ticks: int = 0
    gaps: int = 0

    def __add__(self, other: object) -> "Losses":
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
        segment: its number; None where its recorder wrote no chain.
        files: SHA-256 of the files beside the members, by name.
        signer: fingerprint of the key that its recorder signed with; None without one.
    """

    frames: int
    ticks: int
    wall_ns: int
    lost: Losses
    gap: Losses
    segment: int | None = None
    files: Mapping[str, str] = {}
    signer: str | None = None


class SegmentEnd(NamedTuple):
    """How the recorder ended a segment.

    Attributes:
        ticks: that it has; None where an older recorder ended it.
        closes: nothing need follow, since the gateway itself has ended its connection.
    """

    ticks: int | None
    closes: bool
    why: str


class CoreLineError(ValueError):
    """A core line is not one of this format; the text says why."""


def parsed_line(line: bytes) -> dict[str, Any]:
    """A core line as its object; CoreLineError where it is none."""
    if len(line) > MAX_LINE_BYTES:
        raise CoreLineError(f"is longer than {MAX_LINE_BYTES >> 20} MiB")
    try:
        found = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise CoreLineError(f"is no JSON: {error}") from error
    if not isinstance(found, dict) or not _is_number(found.get("f")):
        raise CoreLineError("has no number of frames before it")
    return found


def _is_number(value: object) -> bool:
    return type(value) is int and value in _NUMBERS


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
        gap = sum((_gap(one) for one in gaps), Losses())
        lost = Losses(*_numbers(begin["lost"], Losses._fields))
        frames, ticks, wall_ns = _numbers(begin, ("frames", "ticks", "wall_ns"))
        segment, files = begin.get("segment"), dict(begin.get("files") or {})
        signer = begin.get("signer")
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CoreLineError(f"has no usable begin or gap: {error}") from error
    return SegmentBegin(frames, ticks, wall_ns, lost, gap, segment, files, signer)


def _gap(values: Mapping[str, Any]) -> Losses:
    frames, ticks = _numbers(values, ("frames", "ticks"))
    return Losses(frames, ticks, 1)


def _numbers(values: Mapping[str, Any], keys: tuple[str, ...]) -> list[int]:
    """These counts, 0 where one is null; ValueError where one is no such number."""
    found = [values[key] or 0 for key in keys]
    if not all(map(_is_number, found)):
        raise ValueError(f"{', '.join(keys)} are no numbers")
    return found


def end_of(line: Mapping[str, Any]) -> SegmentEnd:
    """How this last line of a segment ends it; CoreLineError where it is wrong.

    An older recorder did not say whether it closes the drive: any why but the next segment does.
    """
    end = line["end"]
    if not isinstance(end, dict) or not _is_number(end.get("ticks", 0)):
        raise CoreLineError("has no usable end")
    why = str(end.get("why", ""))
    return SegmentEnd(end.get("ticks"), end.get("closes", why != _GOES_ON) is True, why)


def last_second(path: Path) -> int | None:
    """When the last readable lines of a file were gathered, seconds since 1970."""
    seconds = [part.wall_s for part in members_of(path) if part.wall_s]
    return max(seconds, default=None)


def members_of(path: Path) -> Iterator[Member]:
    """The readable members."""
    return (part for part in read_members(path) if not isinstance(part, MemberDamage))
