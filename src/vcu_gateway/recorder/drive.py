"""Recorded drive of one run of a gateway: its folder, its segments, and what is missing in it."""

import contextlib
import errno
import json
import os
import re
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway import __version__
from vcu_gateway.recorder.ring import Disk
from vcu_gateway.recorder.signing import Signer
from vcu_gateway.recording import chain, layout
from vcu_gateway.recording.datagram import TickParts
from vcu_gateway.recording.members import NO_LINK, whole_members
from vcu_gateway.recording.recorder_status import RecorderTotals
from vcu_gateway.recording.segment import (
    NEXT_BEGINS,
    Losses,
    SegmentBegin,
    SegmentEnd,
    SegmentWriter,
    gap_line,
    read_begin,
    tick_lines,
)
from vcu_gateway.text import ISO_TIME, utc

_TICK = re.compile(rb'^\{"f":\d+,"tick":', re.MULTILINE)


class Position(NamedTuple):
    """How many frames and ticks of a run came before; recorded ones and lost ones."""

    frames: int = 0
    ticks: int = 0


def ticks_of(core_lines: bytes) -> int:
    return sum(1 for _ in _TICK.finditer(core_lines))


def _recorded(segments: Sequence[layout.SegmentFiles]) -> tuple[Position, Losses]:
    """How far these segments of a drive go, and what is lost up to there."""
    frames = ticks = 0
    for segment in reversed(segments):
        frames += sum(member.lines for member in whole_members(segment.frames))
        ticks += sum(ticks_of(member.data) for member in whole_members(segment.core))
        begin = read_begin(segment.core)
        if begin is not None:
            return Position(begin.frames + frames, begin.ticks + ticks), begin.lost
    return Position(frames, ticks), Losses()


_MEMORY_FULL = "the recorder's memory was full"


class DriveRecorder:
    """Writes one drive; belongs to the writer's thread.

    Attributes:
        folder: of the drive; made with its first segment.
        segment: being written; None where only a checkpoint can begin one.
        hello: what its gateway said of itself.
    """

    def __init__(
        self,
        drives: Path,
        number: int,
        hello: Mapping[str, Any],
        totals: RecorderTotals,
        disk: Disk,
        segment_ended: Callable[[Path, int], None],
        signer: Signer | None = None,
    ) -> None:
        self.folder = drives / layout.drive_name(hello["clock"]["wall_ns"], hello["run"])
        self.segment: SegmentWriter | None = None
        self.hello = hello
        self._number = number
        self._totals = totals
        self._disk = disk
        self._segment_ended = segment_ended
        self._signer = signer
        self._lost = Losses()
        self._clock_ns = hello["clock"]["wall_ns"] - hello["clock"]["monotonic_ns"]
        self._hold: int | None = None
        self._next_segment = 1
        self._link = NO_LINK
        self._files_beside: Mapping[str, str] = {}
        self._next_sequence = self._frames_not_handed_on = 0
        self._begin_position = self._position = Position()
        self._waiting_ticks = self._segment_ticks = 0
        self._end_stands = False
        self._missing_because: str | None = "the recorder was not connected yet"

    def take(self, tick: TickParts) -> bool:
        """Take one datagram; False where it cannot be read without a checkpoint before it.

        OSError where a segment cannot be begun: then nothing of it was taken.
        """
        if tick.begins_segment:
            lines = self._begin(tick)
        elif self.segment is None or tick.header.sequence != self._next_sequence:
            self._missing_because = self._missing_because or _MEMORY_FULL
            return False
        else:
            lines = tick.lines
        frame_text = tick_lines(self.hello["channel"], tick, self._clock_ns)
        if self.segment is not None:
            self.segment.add(lines.decode(errors="replace"), frame_text, tick.frame_count)
        self._waiting_ticks += ticks_of(lines)
        self._next_sequence = tick.header.sequence + 1
        return True

    def _begin(self, tick: TickParts) -> bytes:
        """Begin a segment with this datagram's checkpoint; the lines behind that."""
        self.end(NEXT_BEGINS)
        self._open_folder()
        number, self._next_segment = self._next_segment, self._next_segment + 1
        segment = SegmentWriter(self.folder, number, self._link)
        checkpoint, line_end, rest = tick.lines.partition(b"\n")
        begins = Position(tick.header.frames - tick.frame_count, _ticks_so_far(checkpoint))
        head = (checkpoint + line_end).decode(errors="replace")
        segment.add(head + self._begin_lines(number, begins, tick.header.frames_lost))
        self.segment, self._end_stands = segment, False
        self._begin_position = self._position = begins
        self._segment_ticks = self._waiting_ticks = 0
        with contextlib.suppress(OSError):  # it waits, then, and the next flush says why
            self.flush()
        return rest

    def _begin_lines(self, number: int, begins: Position, not_handed_on: int) -> str:
        frames = max(0, begins.frames - self._position.frames)
        ticks = max(0, begins.ticks - self._position.ticks)
        gap = ""
        if frames or ticks:
            self._lost += Losses(frames, ticks, 1)
            self._totals.gaps += 1
            self._totals.frames_lost += frames
            self._totals.ticks_lost += ticks
            if not_handed_on - self._frames_not_handed_on >= frames > 0:
                self._missing_because = "the recorder did not take them in time"
            gap = gap_line(frames, ticks, self._missing_because or _MEMORY_FULL)
        self._frames_not_handed_on = not_handed_on
        self._missing_because = None
        signer = None if self._signer is None else self._signer.fingerprint
        files, wall_ns = self._files_beside, time.time_ns()
        begin = SegmentBegin(*begins, wall_ns, __version__, self._lost, number, files, signer)
        return begin.line() + gap

    def _open_folder(self) -> None:
        if self._hold is not None:
            if os.path.isdir(self.folder):
                return
            self._release()
        else:
            self.folder = layout.free_path(self.folder, self._is_own)
            if os.path.lexists(self.folder):
                self._resume()
        if not os.path.isdir(self.folder):
            more = {"number": self._number, "created": utc(time.time_ns(), ISO_TIME)}
            more |= {"format": layout.FORMAT, "recorder": __version__}
            layout.create_folder(self.folder, layout.drive_files(self.hello, **more))
        self._files_beside = chain.file_digests(self.folder)
        self._hold = layout.hold(self.folder)

    def _is_own(self, folder: Path) -> bool:
        """True for this run's folder; the name of another run's is not taken."""
        described = layout.description_if_any(folder / layout.DRIVE_FILE)
        return bool(described.get("run") == self.hello["run"])

    def _resume(self) -> None:
        """Go on where the files of this drive end; OSError where they cannot be read."""
        segments = layout.segments(self.folder)
        if self._next_segment == 1:
            self._position, self._lost = _recorded(segments)
            end = chain.end(self.folder)
            self._link = (end and end.member.digest) or NO_LINK
            self._missing_because = "the recorder had ended"
        if segments:
            self._next_segment = max(self._next_segment, segments[-1].number + 1)

    def flush(self) -> None:
        """Write what waits; OSError leaves it waiting."""
        if self.segment is None:
            return
        frames, size = self.segment.recorded_frames, self.segment.size
        try:
            self.segment.flush(int(time.time()))
            self._segment_ticks += self._waiting_ticks
            self._totals.ticks += self._waiting_ticks
            self._waiting_ticks = 0
        finally:
            self._totals.frames += self.segment.recorded_frames - frames
            self._totals.bytes += self.segment.size - size

    def sync(self) -> None:
        """Have on the disk what was written; FileNotFoundError where somebody removed it."""
        if self.segment is None:
            return
        begin_s = time.monotonic()
        try:
            self.segment.sync()
        except OSError:
            self._totals.sync_failures += 1
            raise
        self._totals.syncs += 1
        self._disk.synced(time.monotonic() - begin_s)
        if not self.segment.is_in_place:
            what = "somebody removed what was being written"
            raise FileNotFoundError(errno.ENOENT, what, str(self.folder))

    def end(self, why: str, closes: bool = False) -> None:
        """End the segment in order; OSError leaves it as it is, to be tried again.

        `closes`: nothing need follow, since the gateway itself has ended the drive.
        """
        if self.segment is None:
            return
        if not self._end_stands:
            ticks = self._segment_ticks + self._waiting_ticks
            self.segment.add(SegmentEnd(self.segment.frames, ticks, closes, why).line())
            self._end_stands = True
        self.flush()
        self.sync()
        self._leave_segment()

    def abandon(self, why: str) -> None:
        """End the segment as it is on the disk; what waits is lost, and a gap will say so."""
        self._missing_because = why
        self._leave_segment()

    def _leave_segment(self) -> None:
        if self.segment is None:
            return
        with contextlib.suppress(OSError):
            self.segment.close()
        begins = self._begin_position
        self._position = Position(
            begins.frames + self.segment.recorded_frames, begins.ticks + self._segment_ticks
        )
        segment, self.segment = self.segment, None
        self._segment_ended(self.folder, segment.number)
        if segment.link is not None and segment.link != self._link:
            self._link = segment.link
            if self._signer is not None:
                run = self.hello["run"]
                self._signer.segment_ended(self.folder, run, segment.number, self._link)

    def close(self, why: str, closes: bool = False) -> None:
        """End the drive, until its gateway connects again; OSError and `closes` as `end`."""
        self.end(why, closes)
        self._missing_because = self._missing_because or "the gateway was not connected"
        self._release()

    def _release(self) -> None:
        if self._hold is not None:
            os.close(self._hold)
            self._hold = None


def _ticks_so_far(checkpoint: bytes) -> int:
    """Ticks before a checkpoint; 0 where it does not say."""
    try:
        return int(json.loads(checkpoint)["checkpoint"]["ticks"])
    except (ValueError, KeyError, TypeError, RecursionError):
        return 0
