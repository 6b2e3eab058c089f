"""Segment of a drive: its writer, a gzip member a second in each file, and the recorder's lines.

These say how a segment begins, what is missing before it, and how it ends:

    {"f":0,"begin":{"frames":71600,"ticks":4000,"wall_ns":...,"recorder":"0.1.0",...}}
    {"f":0,"gap":{"frames":358,"ticks":20,"why":"the recorder's memory was full"}}
    {"f":21480,"end":{"frames":21480,"ticks":1200,"closes":true,"why":"..."}}

A begin stands behind the checkpoint of its segment, and a gap behind the begin.

Frames are candump's log lines with nanoseconds and direction, as `candump -l -x` writes them:

    (1763920000.123456789) can0 040AD079#0011223344556677 R

R: received, T: the echo of an own frame. A remote frame is `#R`, an FD frame `##0...`, an error
frame has bit 29 of the identifier set, as in `20000040#`.
"""

import contextlib
import json
import os
import struct
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway import files
from vcu_gateway.recording import datagram, layout, members
from vcu_gateway.recording.datagram import (
    CLASSIC,
    ERROR,
    EXTENDED,
    ID_MASK,
    REMOTE,
    CoreLineError,
    TickParts,
)
from vcu_gateway.recording.members import Member, read_members, whole_members
from vcu_gateway.units import NS_PER_S

LINES_OF_BEGIN = 4
"""Of a segment, among which its begin and its gaps are."""
MAX_LINE_BYTES = 1 << 22
"""Of a core line; a longer one is damage, or an attack on the reader's memory."""
NEXT_BEGINS = "the next segment begins"


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
        lost: of the whole drive up to here.
        segment: its number; None where its recorder wrote no chain.
        files: SHA-256 of the files beside the members, by name.
        signer: fingerprint of the key that its recorder signed with; None without one.
        gap: what is missing right before this segment, of what is lost; in lines of its own.
    """

    frames: int
    ticks: int
    wall_ns: int
    recorder: str
    lost: Losses
    segment: int | None = None
    files: Mapping[str, str] = {}
    signer: str | None = None
    gap: Losses = Losses()

    def line(self) -> str:
        """As the recorder writes it, without the gap."""
        told = {**self._asdict(), "lost": self.lost._asdict()}
        without = {"gap", "signer"} if self.signer is None else {"gap"}
        return _line(0, begin={key: value for key, value in told.items() if key not in without})


class SegmentEnd(NamedTuple):
    """How the recorder ended a segment.

    Attributes:
        frames, ticks: that it has; None where an older recorder ended it.
        closes: nothing need follow, since the gateway itself has ended its connection.
    """

    frames: int | None
    ticks: int | None
    closes: bool
    why: str

    def line(self) -> str:
        return _line(self.frames or 0, end=self._asdict())


def gap_line(frames: int, ticks: int, why: str) -> str:
    """What is missing before a segment, as the recorder writes it."""
    return _line(0, gap={"frames": frames, "ticks": ticks, "why": why})


def _line(frames_before: int, **told: Mapping[str, Any]) -> str:
    return json.dumps({"f": frames_before, **told}, separators=(",", ":")) + "\n"


def parsed_line(line: bytes) -> dict[str, Any]:
    """A core line as its object; CoreLineError where it is none."""
    if len(line) > MAX_LINE_BYTES:
        raise CoreLineError(f"is longer than {MAX_LINE_BYTES >> 20} MiB")
    try:
        found = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise CoreLineError(f"is no JSON: {error}") from error
    if not isinstance(found, dict) or not is_number(found.get("f")):
        raise CoreLineError("has no number of frames before it")
    return found


def is_number(value: object) -> bool:
    """True for what a counter or a stamp can be."""
    return type(value) is int and 0 <= value < 1 << 63


def read_begin(core: Path | None) -> SegmentBegin | None:
    """The begin of a segment by its first member; None where it is damaged, or not there."""
    first = None if core is None else next(read_members(core), None)
    if not isinstance(first, Member):
        return None
    lines = first.data.split(b"\n", LINES_OF_BEGIN)[:LINES_OF_BEGIN]
    with contextlib.suppress(CoreLineError):
        return begin_of([parsed_line(line) for line in lines if line])
    return None


def begin_of(lines: list[dict[str, Any]]) -> SegmentBegin | None:
    """The begin that stands in the first lines of a segment; CoreLineError where it is wrong."""
    begin = next((line["begin"] for line in lines if "begin" in line), None)
    if begin is None:
        return None
    try:
        gaps = [_numbers(line["gap"], ("frames", "ticks")) for line in lines if "gap" in line]
        gap = sum((Losses(frames, ticks, 1) for frames, ticks in gaps), Losses())
        lost = Losses(*_numbers(begin["lost"], Losses._fields))
        frames, ticks, wall_ns = _numbers(begin, ("frames", "ticks", "wall_ns"))
        files = dict(begin.get("files") or {})
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CoreLineError(f"has no usable begin or gap: {error}") from error
    told = [begin.get(key) for key in ("recorder", "segment", "signer")]
    return SegmentBegin(frames, ticks, wall_ns, str(told[0]), lost, told[1], files, told[2], gap)


def _numbers(values: Mapping[str, Any], keys: tuple[str, ...]) -> list[int]:
    """These counts, 0 where one is null; ValueError where one is no such number."""
    found = [values[key] or 0 for key in keys]
    if not all(map(is_number, found)):
        raise ValueError(f"{', '.join(keys)} are no numbers")
    return found


def end_of(line: Mapping[str, Any]) -> SegmentEnd:
    """How this last line of a segment ends it; CoreLineError where it is wrong.

    An older recorder did not say whether it closes the drive: any why but the next segment does.
    """
    end = line["end"]
    if not isinstance(end, dict) or not is_number(end.get("ticks", 0)):
        raise CoreLineError("has no usable end")
    why = str(end.get("why", ""))
    closes = end.get("closes", why != NEXT_BEGINS) is True
    return SegmentEnd(end.get("frames"), end.get("ticks"), closes, why)


def last_second(path: Path | None) -> int | None:
    """When the last readable lines of a file were gathered, seconds since 1970; None without."""
    return max((part.wall_s for part in whole_members(path) if part.wall_s), default=None)


class MemberFile:
    """File of members that only grows; made by this process, never opened again.

    It has that many lines and bytes in whole members; what is waiting has no member yet.
    """

    def __init__(self, path: Path) -> None:
        """Make the file; FileExistsError where it is there already."""
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND | os.O_CLOEXEC
        self._descriptor = os.open(path, flags, 0o640)
        self.path = path
        self.lines = self.size = 0
        self.waiting: list[str] = []

    def append(self, data: bytes, wall_s: int, link: bytes | None = None) -> bytes:
        """Write whole lines as one member, and give its digest; OSError leaves none of it."""
        member, written = members.packed(data, self.lines, wall_s, link), 0
        try:
            while written < len(member):
                written += os.write(self._descriptor, memoryview(member)[written:])
        except OSError:
            if written:  # a disk that is full takes a part
                os.ftruncate(self._descriptor, self.size)
            raise
        self.size += len(member)
        self.lines += data.count(b"\n")
        return members.digest_of(member)

    def sync(self) -> None:
        os.fdatasync(self._descriptor)

    @property
    def is_in_place(self) -> bool:
        """False where somebody removed it, or its folder."""
        with contextlib.suppress(OSError):
            return os.path.samestat(self.path.stat(), os.fstat(self._descriptor))
        return False

    def close(self) -> None:
        os.close(self._descriptor)


class SegmentWriter:
    """Both files of one segment, and the lines that wait for the next member.

    Frames are written before the core lines that count them.

    Attributes:
        link: digest of the last member written to the drive; None: members are not chained.
        frames: how many it was given; the `f` of the next core line.
        waiting: characters that no member has yet.
    """

    def __init__(self, folder: Path, number: int, link: bytes | None = None) -> None:
        """Make both files; FileExistsError where there is one, else OSError as the disk has it."""
        self.number = number
        self.link = link
        self.frames = self.waiting = 0
        self._frames_file = MemberFile(folder / layout.frames_name(number))
        try:
            self._core_file = MemberFile(folder / layout.core_name(number))
            files.sync(folder)
        except OSError:
            self._frames_file.close()
            self._frames_file.path.unlink(missing_ok=True)
            raise
        self._files = (self._frames_file, self._core_file)

    @property
    def size(self) -> int:
        return sum(file.size for file in self._files)

    @property
    def recorded_frames(self) -> int:
        return self._frames_file.lines

    @property
    def is_in_place(self) -> bool:
        return all(file.is_in_place for file in self._files)

    def add(self, core_text: str, frame_text: str = "", frames: int = 0) -> None:
        """Core lines, and that many frame lines before them; each with its line end."""
        self.frames += frames
        self.waiting += len(frame_text) + len(core_text)
        self._frames_file.waiting.append(frame_text)
        self._core_file.waiting.append(core_text)

    def flush(self, wall_s: int) -> None:
        """Write what waits, a member for each file; OSError leaves what is unwritten waiting."""
        for file in self._files:
            text = "".join(file.waiting).encode()
            if text:
                digest = file.append(text, wall_s, self.link)
                self.link = digest if self.link is not None else None
            file.waiting.clear()
        self.waiting = 0

    def sync(self) -> None:
        for file in self._files:
            file.sync()

    def close(self) -> None:
        """Close both files; what waits is lost."""
        for file in self._files:
            file.close()


_CLASSIC_BYTES = 8
_KEPT = 4096
"""Texts by identifier, whatever a flood sends."""
_STAMP_AND_KIND = struct.Struct("<q6s8x")
_KIND = struct.Struct("<IBB")
_PAYLOAD_AT = 2 * (CLASSIC.size - _CLASSIC_BYTES)
_PAYLOAD_END = 2 * CLASSIC.size


def frame_line(channel: str, wall_ns: int, can_id: int, data: bytes, own_echo: bool) -> str:
    """One frame with its line end; `can_id` has Linux's flags, a remote frame no data."""
    seconds, nanoseconds = divmod(wall_ns, NS_PER_S)
    payload, direction = data.hex().upper(), "T" if own_echo else "R"
    if can_id & REMOTE:
        payload = "R"
    elif len(data) > _CLASSIC_BYTES:
        payload = f"#0{payload}"
    return f"({seconds}.{nanoseconds:09d}){_head(channel, can_id)}{payload} {direction}\n"


def tick_lines(channel: str, tick: TickParts, clock_ns: int) -> str:
    """All frames of a tick; `clock_ns` is the wall clock less the gateway's monotonic one."""
    if len(tick.frames) == tick.frame_count * CLASSIC.size and clock_ns >= NS_PER_S:
        with contextlib.suppress(ValueError):
            return _classic(channel, tick.frames, clock_ns)
    return "".join(
        frame_line(channel, arrival_ns + clock_ns, can_id, data, own_echo)
        for arrival_ns, can_id, own_echo, data in datagram.frame_records(tick.frames)
    )


def _classic(channel: str, packed: bytes, clock_ns: int) -> str:
    """Frames with eight bytes each; ValueError where one is of another kind.

    As quick as Python can: an identifier's text is made once, all payloads' together.
    """
    place, lines = _PAYLOAD_AT, []
    digits = packed.hex().upper()
    for arrival_ns, kind in _STAMP_AND_KIND.iter_unpack(packed):
        head, tail = _around(channel, kind)
        stamp = str(arrival_ns + clock_ns)
        payload = digits[place : place + 2 * _CLASSIC_BYTES]
        lines.append(f"({stamp[:-9]}.{stamp[-9:]}){head}{payload}{tail}")
        place += _PAYLOAD_END
    return "".join(lines)


@lru_cache(_KEPT)
def _around(channel: str, kind: bytes) -> tuple[str, str]:
    """What stands around the payload; ValueError where that is not just eight bytes."""
    can_id, own_echo, length = _KIND.unpack(kind)
    if length != _CLASSIC_BYTES or can_id & REMOTE:
        raise ValueError
    return _head(channel, can_id), " T\n" if own_echo else " R\n"


@lru_cache(_KEPT)
def _head(channel: str, can_id: int) -> str:
    if can_id & ERROR:
        return f" {channel} {can_id & ID_MASK | ERROR:08X}#"
    digits = f"{can_id & ID_MASK:08X}" if can_id & EXTENDED else f"{can_id & 0x7FF:03X}"
    return f" {channel} {digits}#"
