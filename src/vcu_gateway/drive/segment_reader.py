"""Reader of one segment: frames and core lines of its two files, put into one order."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.core.inputs import FrameInput
from vcu_gateway.drive.core_line_parser import LineParser, Placed
from vcu_gateway.drive.frame_lines import frame_of
from vcu_gateway.drive.records import Checkpoint, CoreRecord, Gap, InputRecord, TickRecord
from vcu_gateway.drive_format.layout import SegmentFiles
from vcu_gateway.drive_format.members import MemberDamage, read_members
from vcu_gateway.errors import DataError, Problem

_NO_CHECKPOINT = "does not begin with a checkpoint"


class _Line(NamedTuple):
    text: str
    number: int


class _Lines:
    """Lines of one file up to the first damage.

    Attributes:
        damage: why they ended before the end of the file; empty where they did not.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.damage = ""

    def __iter__(self) -> Iterator[_Line]:
        if self._path is None:
            self.damage = "a file of the segment is not there"
            return
        for part in read_members(self._path):
            if isinstance(part, MemberDamage):
                self.damage = f"{self._path.name}: {part.what}"
                return
            for number, text in enumerate(part.data.decode().splitlines(), part.first_line + 1):
                yield _Line(text, number)


class SegmentReader:
    """Records of one segment; `before` is the reader of the one before, which has come to its end.

    Attributes:
        number: of the segment.
        begun: it, or one before it, has begun with a checkpoint.
        frames, ticks: since the start of the gateway, up to where its records end.
        damage: why they end before the segment does; empty where they do not.
    """

    def __init__(
        self, files: SegmentFiles, distance_ns: int, before: "SegmentReader | None" = None
    ) -> None:
        self.number = files.number
        self.begun = before is not None
        self.frames: int = before.frames if before else 0
        self.ticks: int = before.ticks if before else 0
        self.damage = ""
        self._files = files
        self._distance_ns = distance_ns
        self._before = before
        self._core_lines = _Lines(files.core)
        self._frame_lines = _Lines(files.frames)

    def records(self) -> Iterator[CoreRecord]:
        """Gap, checkpoint, and then every call and result in order."""
        placed = self._placed()
        first, second = next(placed, None), next(placed, None)
        if first is None or not isinstance(first.record, Checkpoint):
            self.damage = self._core_lines.damage or f"{self._files.core}: {_NO_CHECKPOINT}"
            yield Gap(None, None, None, self.damage)
            return
        told = second.record if second and isinstance(second.record, Gap) else None
        yield from self._missing(first.record, told)
        yield first.record
        self.begun = True
        self.frames, self.ticks = first.record.frames, first.record.ticks
        yield from self._in_order(second, placed)

    def _missing(self, begin: Checkpoint, told: Gap | None) -> Iterator[Gap]:
        """What is missing between the segment before and this one."""
        before = self._before
        if before is None:
            if told is not None:
                yield told
            return
        frames, ticks = begin.frames - before.frames, begin.ticks - before.ticks
        if frames <= 0 and ticks <= 0:
            return
        why = before.damage or ("" if told is None else told.why)
        if self.number != before.number + 1:
            why = f"segments {before.number + 1} to {self.number - 1} are not there"
        yield Gap(max(frames, 0), max(ticks, 0), None, why or "it was not recorded")

    def _in_order(self, second: Placed | None, placed: Iterator[Placed]) -> Iterator[CoreRecord]:
        frames, taken = self._frame_records(), 0
        while second is not None:
            while taken < second.frames_before:
                frame = next(frames, None)
                if frame is None:
                    self.damage = self._frame_lines.damage or "frames are missing"
                    yield Gap(None, None, None, self.damage)
                    return
                yield frame
                taken += 1
                self.frames += 1
            if not isinstance(second.record, Gap):
                self.ticks += isinstance(second.record, TickRecord)
                yield second.record
            second = next(placed, None)
        for frame in frames:
            self.frames += 1
            yield frame
        if damage := self._core_lines.damage or self._frame_lines.damage:
            self.damage = damage
            yield Gap(None, None, None, damage)

    def _placed(self) -> Iterator[Placed]:
        parser = LineParser()
        for line in self._core_lines:
            try:
                yield from parser.records(line.text)
            except ValueError as error:
                raise _problem(error, self._files.core, line) from error

    def _frame_records(self) -> Iterator[InputRecord]:
        distance_ns = self._distance_ns
        for line in self._frame_lines:
            try:
                frame = frame_of(line.text, distance_ns)
            except ValueError as error:
                raise _problem(error, self._files.frames, line) from error
            yield InputRecord(FrameInput(frame), None)


def _problem(error: ValueError, path: Path | None, line: _Line) -> DataError:
    remedy = "vcu-gateway recordings check says what else is damaged"
    return DataError(Problem(str(error), f"{path}:{line.number}", remedy))
