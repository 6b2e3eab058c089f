"""Reader of one segment: frames and core lines of its two files, put into one order."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.core.j1939 import Frame
from vcu_gateway.drive.core_line_parser import LineParser, Placed
from vcu_gateway.drive.records import Checkpoint, CoreRecord, FrameRun, Gap, TickRecord
from vcu_gateway.drive_format.layout import SegmentFiles
from vcu_gateway.drive_format.members import Member, MemberDamage, whole_members
from vcu_gateway.errors import DataError, Problem
from vcu_gateway.recording.candump import recorded_frame, recorded_frames

_NO_CHECKPOINT = "does not begin with a checkpoint"


class _Line(NamedTuple):
    text: str
    number: int


class _SegmentMembers:
    """Members of one file up to the first damage.

    Attributes:
        damage: why they ended before the end of the file; empty where they did not.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self.damage = ""

    def __iter__(self) -> Iterator[Member]:
        if self._path is None:
            self.damage = "a file of the segment is not there"
        for member in whole_members(self._path, self._end):
            if self.damage:
                return
            yield member

    def _end(self, damage: MemberDamage) -> None:
        if self._path is not None and not self.damage:
            self.damage = f"{self._path.name}: {damage.what}"


def _lines(member: Member) -> Iterator[_Line]:
    for number, line in member.numbered_lines():
        yield _Line(line.decode(errors="replace"), number)


class _FrameSource:
    """Frames of a segment, taken in runs of any length."""

    def __init__(self, members: _SegmentMembers, path: Path | None, distance_ns: int) -> None:
        self._members = iter(members)
        self._path = path
        self._distance_ns = distance_ns
        self._waiting: list[Frame] = []

    def take(self, count: int) -> list[Frame]:
        waiting = self._waiting
        while len(waiting) < count and (member := next(self._members, None)) is not None:
            waiting += self._frames(member)
        taken, self._waiting = waiting[:count], waiting[count:]
        return taken

    def rest(self) -> Iterator[list[Frame]]:
        if self._waiting:
            yield self.take(len(self._waiting))
        for member in self._members:
            yield self._frames(member)

    def _frames(self, member: Member) -> list[Frame]:
        frames = recorded_frames(member.data, self._distance_ns)
        if frames is not None:
            return frames
        return [self._frame(line) for line in _lines(member)]

    def _frame(self, line: _Line) -> Frame:
        try:
            return recorded_frame(line.text, self._distance_ns)
        except ValueError as error:
            raise _problem(error, self._path, line) from error


class SegmentReader:
    """Records of one segment; `before` is the reader of the one before, which has come to its end.

    Attributes:
        number: of the segment.
        begun: it, or one before it, has begun with a checkpoint.
        frames, ticks: since the start of the gateway, up to where its records end.
        line: of the core lines' file, the latest that was read.
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
        self.line = 0
        self._files = files
        self._distance_ns = distance_ns
        self._before = before
        self._core_members = _SegmentMembers(files.core)
        self._frame_members = _SegmentMembers(files.frames)

    def runs(self) -> Iterator[FrameRun | CoreRecord]:
        """Gap, checkpoint, and then every run of frames, call and result in order."""
        placed = self._placed()
        first, second = next(placed, None), next(placed, None)
        if first is None or not isinstance(first.record, Checkpoint):
            self.damage = self._core_members.damage or f"{self._files.core}: {_NO_CHECKPOINT}"
            yield Gap(None, None, None, self.damage)
            return
        told = second.record if second and isinstance(second.record, Gap) else None
        yield from self._missing(first.record, told)
        yield first.record
        self.begun = True
        self.frames, self.ticks = first.record.frames, first.record.ticks
        yield from self._in_order(second, placed)

    def _missing(self, begin: Checkpoint, told: Gap | None) -> Iterator[Gap]:
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

    def _in_order(
        self, second: Placed | None, placed: Iterator[Placed]
    ) -> Iterator[FrameRun | CoreRecord]:
        source, taken = _FrameSource(self._frame_members, self._files.frames, self._distance_ns), 0
        while second is not None:
            if taken < second.frames_before:
                frames = source.take(second.frames_before - taken)
                yield self._run(frames)
                taken += len(frames)
                if taken < second.frames_before:
                    self.damage = self._frame_members.damage or "frames are missing"
                    yield Gap(None, None, None, self.damage)
                    return
            if not isinstance(second.record, Gap):
                self.ticks += isinstance(second.record, TickRecord)
                yield second.record
            second = next(placed, None)
        for frames in source.rest():
            yield self._run(frames)
        if damage := self._core_members.damage or self._frame_members.damage:
            self.damage = damage
            yield Gap(None, None, None, damage)

    def _run(self, frames: list[Frame]) -> FrameRun:
        self.frames += len(frames)
        return FrameRun(frames)

    def _placed(self) -> Iterator[Placed]:
        parser = LineParser()
        for member in self._core_members:
            for line in _lines(member):
                self.line = line.number
                try:
                    yield from parser.records(line.text)
                except ValueError as error:
                    raise _problem(error, self._files.core, line) from error


def _problem(error: ValueError, path: Path | None, line: _Line) -> DataError:
    remedy = "vcu-gateway recordings check says what else is damaged"
    return DataError(Problem(str(error), f"{path}:{line.number}", remedy))
