"""Reader of recorded drives: what a gateway was given and what it answered, in order.

    drive = open_drive(Path("drives/20261123T180412Z-1f3a9c2e"))
    for record in drive.records():
        ...

Memory does not grow with the drive. What is missing is a `Gap`; after it a checkpoint follows.
"""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.core.calls import Receive
from vcu_gateway.core.schedule import ClockPair
from vcu_gateway.core.settings import Settings
from vcu_gateway.drive.records import CoreRecord, FrameRun, InputRecord
from vcu_gateway.drive.segment_reader import SegmentReader
from vcu_gateway.drive.settings_json import settings_of
from vcu_gateway.drive_format import chain, layout
from vcu_gateway.drive_format.layout import SegmentFiles
from vcu_gateway.drive_format.members import whole_members
from vcu_gateway.drive_format.segment_lines import SegmentBegin, read_begin
from vcu_gateway.errors import DataError, MissingInputError, Problem
from vcu_gateway.recording import candump
from vcu_gateway.recording.recorded import RecordedFrame


class DriveInfo(NamedTuple):
    """What a gateway said of itself when it began to be recorded.

    Attributes:
        run: id of its process.
        versions: of the program, Python, the kernel and the machine.
        clock: wall time of a frame is arrival_ns + clock.distance_ns.
        settings: in effect when the drive began; those of a checkpoint are later ones.
        config, dbc: the texts.
        described: all of drive.json.
    """

    run: str
    channel: str
    versions: dict[str, str]
    clock: ClockPair
    settings: Settings
    config: str
    config_digest: str
    dbc: str
    described: dict[str, Any]


def open_drive(path: Path) -> "Drive":
    """A drive's or an incident's folder, or one file of a segment in it.

    Raises MissingInputError or DataError, with the file and what to do; DataError also where a
    file beside the members is not the one that the recorder wrote: what it says would be of
    another drive.
    """
    folder, only = path, None
    if path.is_file() and (number := layout.segment_number(path.name)) is not None:
        folder, only = path.parent, number
    elif not path.is_dir():
        what = "is no recorded drive" if path.exists() else "is not there"
        remedy = "give a drive's or an incident's folder, or a segment's file in it"
        raise MissingInputError(Problem(what, str(path), remedy))
    info = _info(folder)
    segments = layout.segments(folder)
    compare_with_digests(folder, segments)
    files = [one for one in segments if only in (None, one.number)]
    return Drive(folder, info, tuple(files))


def compare_with_digests(folder: Path, segments: list[SegmentFiles]) -> None:
    """DataError where the first segment's begin names other digests; older ones name none."""
    begin = next(filter(None, (_begin(files.core) for files in segments)), None)
    if begin is None or not begin.files:
        return
    found = chain.file_digests(folder)
    for name in layout.FILES_BESIDE:
        if found.get(name) != begin.files.get(name):
            what = "is not the file that the recorder wrote: the recording names another SHA-256"
            remedy = "vcu-gateway recordings check says what else was changed"
            raise DataError(Problem(what, str(folder / name), remedy))


def _begin(core: Path | None) -> SegmentBegin | None:
    with contextlib.suppress(OSError):
        return read_begin(core)
    return None


def _info(folder: Path) -> DriveInfo:
    path = folder / layout.DRIVE_FILE
    described = layout.read_description(path)
    try:
        return DriveInfo(
            run=described["run"],
            channel=layout.plain_reason(described["channel"]),
            versions=dict(described["versions"]),
            clock=clock_of(described),
            settings=settings_of(described["settings"]),
            config=_text(folder / layout.CONFIG_FILE),
            config_digest=str(described.get("config_digest", "")),
            dbc=_text(folder / layout.DBC_FILE),
            described=described,
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        version = described.get("versions", {})
        what = f"cannot be used ({type(error).__name__}: {error}); written by {version}"
        raise DataError(Problem(what, str(path))) from error


def clock_of(described: Mapping[str, Any]) -> ClockPair:
    """Both clocks of a drive.json; KeyError, TypeError or ValueError where they are none."""
    clock = described["clock"]
    return ClockPair(_stamp(clock["monotonic_ns"]), _stamp(clock["wall_ns"]))


def _stamp(value: object) -> int:
    if type(value) is not int or not 0 <= value < 1 << 63:
        raise ValueError("a clock is no number of nanoseconds")
    return value


def _text(path: Path) -> str:
    try:
        return layout.read_small(path).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise MissingInputError(Problem(f"cannot be read: {error}", str(path))) from error


class Drive:
    """A recorded drive, or the part of one that is in a folder.

    Attributes:
        segments: files by number; records begin with the checkpoint of each.
    """

    def __init__(self, folder: Path, info: DriveInfo, segments: tuple[SegmentFiles, ...]) -> None:
        self.folder = folder
        self.info = info
        self.segments = segments
        self._read: SegmentReader | None = None

    def records(self, first_segment: int | None = None) -> Iterator[CoreRecord]:
        """As `runs`, each frame as a `Receive`."""
        for record in self.runs(first_segment):
            if type(record) is FrameRun:
                for frame in record.frames:
                    yield InputRecord(Receive(frame), None)
            else:
                yield record  # type: ignore[misc]

    def runs(self, first_segment: int | None = None) -> Iterator[FrameRun | CoreRecord]:
        """Every run of frames, call and result in order, from this segment on.

        Raises DataError where a line is whole and wrong.
        """
        before: SegmentReader | None = None
        for files in self.segments:
            if first_segment is None or files.number >= first_segment:
                segment = SegmentReader(files, self.info.clock.distance_ns, before)
                self._read = segment
                yield from segment.runs()
                before = segment if segment.begun else None

    @property
    def place(self) -> str:
        """Core line up to which records were given last, as file:line."""
        if self._read is None:
            return str(self.folder)
        return f"{self.folder / layout.core_name(self._read.number)}:{self._read.line}"

    def frames(self) -> Iterator[RecordedFrame]:
        """Every frame with its wall time, without what belongs to it; damage is passed by."""
        number = 0
        for files in self.segments:
            for member in whole_members(files.frames):
                for _, line in member.numbered_lines():
                    number += 1
                    frame = candump.recorded_frame(line.decode(errors="replace"))
                    yield RecordedFrame(frame, self.info.channel, number, len(frame.data) > 8)
