"""Check of one segment: every member of both files, every core line.

Commands of a recording, which has each twice: as it was sent, and as the bus gave it back.

    core lines   {"f":9,"tick":...,"frames":[["PCU1","0008A7D0","0c000000e02e0000"],...]}
    frames       (1763920000.123456789) can0 0008A7D0#0C000000E02E0000 T

Every echo has to be one of the commands that were sent before it, in their order. A command
without an echo is none of this: a bus that took no frame gave none back.
"""

import itertools
import re
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.recording import layout
from vcu_gateway.recording.layout import SegmentFiles
from vcu_gateway.recording.members import Member, MemberDamage, whole_members
from vcu_gateway.recording.segment import (
    LINES_OF_BEGIN,
    CoreLineError,
    SegmentBegin,
    SegmentEnd,
    begin_of,
    end_of,
    parsed_line,
)

_ECHO = re.compile(rb" ([0-9A-Fa-f]{1,8})#([!-~]{0,200}) T$", re.MULTILINE)
_KEPT_FROM_BEFORE = 100
_NOT_JUDGED = 2
"""Echoes at the begin of what was recorded: their commands may stand before it."""


class BusCommand(NamedTuple):
    """A frame of the gateway's own.

    Attributes:
        place: frames of the segment before it.
        identifier, data: hexadecimal digits, capital.
    """

    place: int
    identifier: str
    data: str


def commands_in(line: Mapping[str, Any]) -> Iterator[BusCommand]:
    """Frames that a core line says were sent, or were to be; ValueError where they are wrong."""
    frames = line["frames"] if "tick" in line and "frames" in line else []
    if "sent" in line:
        frames = [line["sent"]]
    for _, identifier, data in frames:
        yield BusCommand(line["f"], identifier.upper(), data.upper())


def echoes_in(data: bytes, first_line: int) -> Iterator[BusCommand]:
    place, counted = first_line, 0
    for found in _ECHO.finditer(data):
        place += data.count(b"\n", counted, found.start())
        counted = found.start()
        yield BusCommand(place, found[1].decode().upper(), found[2].decode().upper())


class EchoCheck:
    """Compares echoes with the commands sent before them, over the segments of a drive."""

    def __init__(self) -> None:
        self._sent: dict[str, deque[BusCommand]] = defaultdict(deque)
        self._not_judged: dict[str, int] = {}
        self._begun = False

    def segment(
        self, commands: Iterable[BusCommand], echoes: Iterable[BusCommand], follows: bool
    ) -> Iterator[BusCommand]:
        """Echoes of the next segment that no command explains.

        `follows`: nothing is missing between it and the one before.
        """
        if not (follows and self._begun):
            self._sent.clear()
            self._not_judged = defaultdict(lambda: _NOT_JUDGED)
        self._begun = True
        for waiting in self._sent.values():  # they were sent before this segment
            late = [command._replace(place=-1) for command in waiting][-_KEPT_FROM_BEFORE:]
            waiting.clear()
            waiting.extend(late)
        for command in commands:
            self._sent[command.identifier].append(command)
        return (echo for echo in echoes if not self._explained(echo))

    def _explained(self, echo: BusCommand) -> bool:
        sent = self._sent[echo.identifier]
        for number, command in enumerate(sent):
            if command.place > echo.place:
                break
            if command.data == echo.data:
                for _ in range(number + 1):
                    sent.popleft()
                self._not_judged[echo.identifier] = 0
                return True
        self._not_judged[echo.identifier] -= 1
        return self._not_judged[echo.identifier] >= 0


_MOST_COMMANDS = 1 << 17
"""Of a segment, which has a minute; more are an attack on the reader's memory."""


class FaultKind(Enum):
    """What is wrong with a recording.

    Attributes:
        TORN: the last bytes of a file are no member: a kill, a power cut or a full disk.
        MISSING: something that was recorded, or a whole file, is not there.
        CHANGED: something is not what the recorder wrote.
    """

    TORN = "torn"
    MISSING = "missing"
    CHANGED = "changed"


class FileFault(NamedTuple):
    """What is wrong with a file, or with the whole recording where the name is empty."""

    file: str
    what: str
    kind: FaultKind


class CheckedSegment(NamedTuple):
    """What a check found in a segment.

    Attributes:
        begin: None where that line cannot be read.
        frames: readable ones.
        counted_frames, ticks: that core lines count, up to the last readable one.
        end: the recorder's; None where it did not end it in order.
        commands: frames that the gateway gave to the bus.
        echoes: frames that the bus gave back; only those before which every command is known.
    """

    number: int
    begin: SegmentBegin | None
    frames: int
    counted_frames: int
    ticks: int
    end: SegmentEnd | None
    commands: tuple[BusCommand, ...]
    echoes: tuple[BusCommand, ...]
    faults: tuple[FileFault, ...]


def check_segment(segment: SegmentFiles) -> CheckedSegment:
    """Read both files; OSError as the disk has it.

    The core's first: of a drive that is being written, its lines count frames that are written.
    """
    core = _CoreLines(layout.core_name(segment.number))
    if segment.core is None:
        core.faults.append(FileFault(core.file, "is missing", FaultKind.MISSING))
    else:
        core.read(segment.core)
    if core.end is not None:  # nothing was written behind it
        core.faults = [fault._replace(kind=_ended(fault.kind)) for fault in core.faults]
    is_core_whole = not core.faults
    frames, echoes, faults = _read_frames(segment)
    if core.end is not None and core.end.ticks not in (None, core.ticks):
        what = f"ends with {core.end.ticks} ticks, and has {core.ticks}"
        core.faults.append(FileFault(core.file, what, FaultKind.CHANGED))
    if core.end is not None:
        faults = [fault._replace(kind=_ended(fault.kind)) for fault in faults]
    return CheckedSegment(
        segment.number,
        core.begin,
        frames,
        core.frames,
        core.ticks,
        core.end,
        tuple(core.commands),
        tuple(one for one in echoes if is_core_whole and one.place < core.frames),
        (*faults, *core.faults),
    )


def _ended(kind: FaultKind) -> FaultKind:
    """A recorder that ended a segment left no torn end."""
    return FaultKind.CHANGED if kind is FaultKind.TORN else kind


def _read_frames(segment: SegmentFiles) -> tuple[int, list[BusCommand], list[FileFault]]:
    file, faults = layout.frames_name(segment.number), list[FileFault]()
    echoes: list[BusCommand] = []
    if segment.frames is None:
        return 0, echoes, [FileFault(file, "is missing", FaultKind.MISSING)]
    frames = 0
    for part in _readable(segment.frames, file, faults):
        frames += part.lines
        echoes += itertools.islice(
            echoes_in(part.data, part.first_line), _MOST_COMMANDS - len(echoes)
        )
    return frames, echoes, faults


def _readable(path: Path, file: str, faults: list[FileFault]) -> Iterator[Member]:
    """The readable members; what is between them becomes faults."""

    def damaged(part: MemberDamage) -> None:
        place = f"{part.size} bytes from byte {part.offset} on: " if part.size else ""
        kind = FaultKind.TORN if part.torn else FaultKind.CHANGED
        kind = FaultKind.MISSING if part.lost_lines else kind
        faults.append(FileFault(file, f"{place}{part.what}", kind))

    return whole_members(path, damaged)


@dataclass
class _CoreLines:
    """Core lines of one file, as they are read.

    Attributes:
        frames, ticks: that they count so far.
    """

    file: str
    begin: SegmentBegin | None = None
    frames: int = 0
    ticks: int = 0
    end: SegmentEnd | None = None
    commands: list[BusCommand] = field(default_factory=list)
    faults: list[FileFault] = field(default_factory=list)

    def read(self, path: Path) -> None:
        """Every line of every readable member, up to the first that is wrong."""
        try:
            for part in _readable(path, self.file, self.faults):
                self._take(part)
        except CoreLineError as error:
            self.faults.append(FileFault(self.file, str(error), FaultKind.CHANGED))

    def _take(self, part: Member) -> None:
        lines = (self._line(number, text) for number, text in part.numbered_lines())
        if part.first_line == 0:
            first = list(itertools.islice(lines, LINES_OF_BEGIN))
            if not first or "checkpoint" not in first[0]:
                raise CoreLineError("does not begin with a checkpoint")
            self.begin = begin_of(first)
        deque(lines, maxlen=0)

    def _line(self, number: int, text: bytes) -> dict[str, Any]:
        try:
            line = parsed_line(text)
            self._count(line)
        except CoreLineError as error:
            raise CoreLineError(f"line {number} {error}") from error
        return line

    def _count(self, line: dict[str, Any]) -> None:
        if line["f"] < self.frames:
            raise CoreLineError(f"counts {line['f']} frames after {self.frames}")
        self.frames = line["f"]
        self.ticks += "tick" in line
        self.end = end_of(line) if "end" in line else None
        try:
            self.commands += commands_in(line)
        except (TypeError, ValueError, AttributeError) as error:
            raise CoreLineError(f"has no usable frames: {error}") from error
        if len(self.commands) > _MOST_COMMANDS:
            raise CoreLineError(f"is the {_MOST_COMMANDS}th command of one minute")
