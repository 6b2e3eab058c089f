"""Check of a recording: every member is read, and received = recorded + gaps.

Before each segment the recorder notes how many frames the gateway had handed on, and what of them
it did not get. So between the beginnings of two segments each frame is in a file, or in a gap, or
it is missing.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

from vcu_gateway.drive_format import layout, lock
from vcu_gateway.drive_format.layout import SegmentFiles
from vcu_gateway.errors import GatewayError
from vcu_gateway.recordings.checked_segment import CheckedSegment, FileFault, check_segment
from vcu_gateway.recordings.folder import RecordingPath, read_error
from vcu_gateway.recordings.segment_lines import Losses


class CheckedRecording(NamedTuple):
    """What a check found.

    Attributes:
        frames: recorded and readable.
        gaps: what the recorder did not get, as it says itself.
        missing_frames: received, and neither recorded nor in a gap.
        is_cut_off: it ends without an end: a kill, or a power cut.
        is_written: a recorder is writing it; then its end is not judged.
        faults: what is torn, damaged, missing or wrong, a torn end included.
    """

    name: str
    segments: int
    frames: int
    gaps: Losses
    missing_frames: int
    is_cut_off: bool
    is_written: bool
    faults: tuple[FileFault, ...]

    @property
    def is_whole(self) -> bool:
        """False where something is damaged, or missing and in no gap; torn ends are neither."""
        return not self.missing_frames and all(fault.at_end for fault in self.faults)


def check_recording(
    recording: RecordingPath, progress: Callable[[int], object]
) -> CheckedRecording:
    """Read it whole; `progress` is called with the bytes of each segment.

    What cannot be read of a file is a fault of the result; NotPermittedError or MissingInputError
    where the folder cannot be read.
    """
    try:
        return _checked(recording, progress)
    except OSError as error:
        raise read_error(error, recording.path) from error


def _checked(recording: RecordingPath, progress: Callable[[int], object]) -> CheckedRecording:
    is_written = lock.is_held(recording.path)
    segments = layout.segments(recording.path)
    sums = _Sums()
    sums.faults += _description_faults(recording)
    for segment in segments:
        checked = check_segment(segment)
        is_open = is_written and segment is segments[-1]
        sums.add(checked._replace(faults=()) if is_open else checked)
        progress(_size_bytes(segment))
    if not is_written:
        sums.end()
    return CheckedRecording(
        recording.name,
        len(segments),
        sums.frames,
        sums.gaps,
        sums.missing_frames,
        not is_written and not (sums.last and sums.last.ended),
        is_written,
        tuple(sums.faults),
    )


def _description_faults(recording: RecordingPath) -> Iterator[FileFault]:
    files = [recording.path / layout.DRIVE_FILE, *layout.incident_files(recording.path)]
    for path in files:
        try:
            layout.read_description(path)
        except GatewayError as error:
            yield FileFault(path.name, error.problems[0].what)


def _size_bytes(segment: SegmentFiles) -> int:
    return sum(path.stat().st_size for path in segment.paths)


class _Sums:
    """Sums over the segments so far, and the last of them."""

    def __init__(self) -> None:
        self.last: CheckedSegment | None = None
        self.frames = self.missing_frames = 0
        self.gaps = Losses()
        self.faults: list[FileFault] = []

    def add(self, one: CheckedSegment) -> None:
        """Take the next segment, and compare its begin with the one before."""
        if self.last is not None:
            self._compare(self.last, one)
        if one.begin is not None:
            self.gaps += one.begin.gap
        self.frames += one.frames
        self.faults += one.faults
        self.last = one

    def _compare(self, before: CheckedSegment, one: CheckedSegment) -> None:
        if one.number != before.number + 1:
            what = f"segments between {before.number} and {one.number} are missing"
            self.faults.append(FileFault(layout.frames_name(one.number), what))
        elif before.begin is None or one.begin is None:
            self.missing_frames += max(0, before.counted_frames - before.frames)
        else:
            handed_on = one.begin.frames - before.begin.frames
            self._missing(one, handed_on - before.frames - one.begin.gap.frames)

    def _missing(self, one: CheckedSegment, frames: int) -> None:
        """More than was handed on is as wrong as less."""
        if frames < 0:
            what = f"{-frames} frames more are recorded before it than the gateway handed on"
            self.faults.append(FileFault(layout.core_name(one.number), what))
        self.missing_frames += max(0, frames)

    def end(self) -> None:
        """Judge the last segment by what its own lines count; a torn end tells no number.

        One that the recorder ended has no torn end: what its last line counts was there.
        """
        last = self.last
        if last is None or (not last.ended and any(fault.at_end for fault in last.faults)):
            return
        self.missing_frames += max(0, last.counted_frames - last.frames)
