"""Check of one segment: every member of both files, every core line.

Each command is in a recording twice: as it was sent, and as the bus gave it back.

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
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.recording import layout
from vcu_gateway.recording.chain import FaultKind, FileFault
from vcu_gateway.recording.datagram import CoreLineError
from vcu_gateway.recording.layout import SegmentFiles
from vcu_gateway.recording.members import Member, MemberDamage, whole_members
from vcu_gateway.recording.segment import (
    LINES_OF_BEGIN,
    SegmentBegin,
    SegmentEnd,
    begin_of,
    end_of,
    parsed_line,
)

_ECHO = re.compile(rb" ([0-9A-Fa-f]{1,8})#([!-~]{0,200}) T$", re.MULTILINE)
_NOT_JUDGED = 2
"""Echoes at the begin of what was recorded: their commands may stand before it."""


class BusCommand(NamedTuple):
    """A frame of the gateway's own, in capital digits; `place` frames of its segment before it."""

    place: int
    identifier: str
    data: str


def _commands_in(line: Mapping[str, Any]) -> list[BusCommand]:
    """Frames that a core line says were sent, or were to be; CoreLineError where they are wrong."""
    frames = line["frames"] if "tick" in line and "frames" in line else []
    if "sent" in line:
        frames = [line["sent"]]
    try:
        return [BusCommand(line["f"], digits.upper(), data.upper()) for _, digits, data in frames]
    except (TypeError, ValueError, AttributeError) as error:
        raise CoreLineError(f"has no usable frames: {error}") from error


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
        self._not_judged: dict[str, int] = defaultdict(lambda: _NOT_JUDGED)

    def segment(
        self, commands: Iterable[BusCommand], echoes: Iterable[BusCommand], follows: bool
    ) -> Iterator[BusCommand]:
        """Echoes of the next segment that no command explains.

        `follows`: nothing is missing between it and the one before.
        """
        if not follows:
            self._sent.clear()
            self._not_judged.clear()
        for identifier, waiting in self._sent.items():  # they were sent before this segment
            late = list(waiting)[-100:]
            self._sent[identifier] = deque(one._replace(place=-1) for one in late)
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


@dataclass
class CheckedSegment:
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
    begin: SegmentBegin | None = None
    frames: int = 0
    counted_frames: int = 0
    ticks: int = 0
    end: SegmentEnd | None = None
    commands: list[BusCommand] = field(default_factory=list)
    echoes: list[BusCommand] = field(default_factory=list)
    faults: list[FileFault] = field(default_factory=list)

    @property
    def unread_frames(self) -> int:
        """How many core lines count and no file has."""
        return max(0, self.counted_frames - self.frames)

    @property
    def is_closed(self) -> bool:
        """True where its end closes the drive: nothing need follow."""
        return self.end is not None and self.end.closes


def check_segment(segment: SegmentFiles) -> CheckedSegment:
    """Read both files; OSError as the disk has it.

    The core's first: of a drive that is being written, its lines count frames that are written.
    """
    checked, file = CheckedSegment(segment.number), layout.core_name(segment.number)
    core_faults: list[FileFault] = []
    try:
        for part in _readable(segment.core, file, core_faults):
            _take_core(checked, part)
    except CoreLineError as error:
        core_faults.append(FileFault(file, str(error), FaultKind.CHANGED))
    echoes: list[BusCommand] = []
    for part in _readable(segment.frames, layout.frames_name(segment.number), checked.faults):
        checked.frames += part.lines
        room = _MOST_COMMANDS - len(echoes)
        echoes += itertools.islice(echoes_in(part.data, part.first_line), room)
    if not core_faults:
        checked.echoes = [one for one in echoes if one.place < checked.counted_frames]
    checked.faults += core_faults
    end = checked.end
    if end is not None:
        if end.ticks not in (None, checked.ticks):
            what = f"ends with {end.ticks} ticks, and has {checked.ticks}"
            checked.faults.append(FileFault(file, what, FaultKind.CHANGED))
        # A recorder that ended a segment left no torn end, and wrote nothing behind it.
        torn, changed = FaultKind.TORN, FaultKind.CHANGED
        checked.faults = [
            one._replace(kind=changed) if one.kind is torn else one for one in checked.faults
        ]
    return checked


def _readable(path: Path | None, file: str, faults: list[FileFault]) -> Iterator[Member]:
    """The readable members; what is between them becomes faults."""

    def damaged(part: MemberDamage) -> None:
        place = f"{part.size} bytes from byte {part.offset} on: " if part.size else ""
        kind = FaultKind.TORN if part.torn else FaultKind.CHANGED
        kind = FaultKind.MISSING if part.lost_lines else kind
        faults.append(FileFault(file, f"{place}{part.what}", kind))

    if path is None:
        faults.append(FileFault(file, "is missing", FaultKind.MISSING))
    return whole_members(path, damaged)


def _take_core(checked: CheckedSegment, part: Member) -> None:
    """Take in every line of a member; CoreLineError at the first that is wrong."""
    lines = _counted_lines(checked, part)
    if part.first_line == 0:
        first = list(itertools.islice(lines, LINES_OF_BEGIN))
        if not first or "checkpoint" not in first[0]:
            raise CoreLineError("does not begin with a checkpoint")
        checked.begin = begin_of(first)
    deque(lines, maxlen=0)


def _counted_lines(checked: CheckedSegment, part: Member) -> Iterator[dict[str, Any]]:
    for number, text in part.numbered_lines():
        try:
            line = parsed_line(text)
            _count(checked, line)
        except CoreLineError as error:
            raise CoreLineError(f"line {number} {error}") from error
        yield line


def _count(checked: CheckedSegment, line: Mapping[str, Any]) -> None:
    if line["f"] < checked.counted_frames:
        raise CoreLineError(f"counts {line['f']} frames after {checked.counted_frames}")
    checked.counted_frames = line["f"]
    checked.ticks += "tick" in line
    checked.end = end_of(line) if "end" in line else None
    checked.commands += _commands_in(line)
    if len(checked.commands) > _MOST_COMMANDS:
        raise CoreLineError(f"is the {_MOST_COMMANDS}th command of one minute")
