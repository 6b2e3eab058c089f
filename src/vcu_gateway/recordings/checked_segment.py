"""Check of one segment: every member of both files, every core line."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.drive_format import layout
from vcu_gateway.drive_format.layout import SegmentFiles
from vcu_gateway.drive_format.members import Member, MemberDamage, read_members
from vcu_gateway.recordings.segment_lines import CoreLineError, SegmentBegin, begin_of, parsed_line

_LINES_OF_BEGIN = 4


class FileFault(NamedTuple):
    """What is wrong with a file.

    Attributes:
        at_end: its last bytes are torn, and nothing else: a kill, a power cut or a full disk.
    """

    file: str
    what: str
    at_end: bool = False


class CheckedSegment(NamedTuple):
    """What a check found in a segment.

    Attributes:
        begin: None where that line cannot be read.
        frames: readable ones.
        counted_frames: that core lines count, up to the last readable one.
        ended: the recorder ended it in order.
    """

    number: int
    begin: SegmentBegin | None
    frames: int
    counted_frames: int
    ended: bool
    faults: tuple[FileFault, ...]


def check_segment(segment: SegmentFiles) -> CheckedSegment:
    """Read both files; OSError as the disk has it.

    The core's first: of a drive that is being written, its lines count frames that are written.
    """
    core = _CoreLines(layout.core_name(segment.number))
    if segment.core is None:
        core.faults.append(FileFault(core.file, "is missing"))
    else:
        core.read(segment.core)
    frames, faults = _read_frames(segment)
    return CheckedSegment(
        segment.number,
        core.begin,
        frames,
        core.frames,
        core.ended,
        (*faults, *core.faults),
    )


def _read_frames(segment: SegmentFiles) -> tuple[int, list[FileFault]]:
    file, faults = layout.frames_name(segment.number), list[FileFault]()
    if segment.frames is None:
        return 0, [FileFault(file, "is missing")]
    parts = _readable(segment.frames, file, faults)
    return sum(part.lines for part in parts), faults


def _readable(path: Path, file: str, faults: list[FileFault]) -> Iterator[Member]:
    """The readable members; what is between them becomes faults."""
    lines = 0
    for part in read_members(path):
        if isinstance(part, MemberDamage):
            place = f"{part.size} bytes from byte {part.offset} on: {part.what}"
            faults.append(FileFault(file, place, part.torn))
            continue
        if part.first_line > lines:
            faults.append(FileFault(file, f"{part.first_line - lines} lines are lost"))
        lines = part.first_line + part.lines
        yield part


@dataclass
class _CoreLines:
    """Core lines of one file, as they are read.

    Attributes:
        frames: that they count so far.
    """

    file: str
    begin: SegmentBegin | None = None
    frames: int = 0
    ended: bool = False
    faults: list[FileFault] = field(default_factory=list)

    def read(self, path: Path) -> None:
        """Every line of every readable member, up to the first that is wrong."""
        try:
            for part in _readable(path, self.file, self.faults):
                self._take(part)
        except CoreLineError as error:
            self.faults.append(FileFault(self.file, str(error)))

    def _take(self, part: Member) -> None:
        lines = [self._line(part, number, text) for number, text in enumerate(_texts(part))]
        if part.first_line == 0:
            if "checkpoint" not in lines[0]:
                raise CoreLineError("does not begin with a checkpoint")
            self.begin = begin_of(lines[:_LINES_OF_BEGIN])

    def _line(self, part: Member, number: int, text: bytes) -> dict[str, Any]:
        where = f"line {part.first_line + number + 1}"
        try:
            line = parsed_line(text)
        except CoreLineError as error:
            raise CoreLineError(f"{where} {error}") from error
        if line["f"] < self.frames:
            raise CoreLineError(f"{where} counts {line['f']} frames after {self.frames}")
        self.frames = line["f"]
        self.ended = "end" in line
        return line


def _texts(part: Member) -> list[bytes]:
    return part.data.splitlines()
