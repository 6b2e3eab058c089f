"""Keeping a recording: whole, or a part of it as an incident."""

from pathlib import Path

from vcu_gateway.drive_format import layout, signature
from vcu_gateway.drive_format.layout import SegmentFiles
from vcu_gateway.drive_format.segment_lines import last_second, read_begin
from vcu_gateway.errors import DataError, Problem
from vcu_gateway.recordings.folder import RecordingFolder, RecordingPath, write_error
from vcu_gateway.text import utc
from vcu_gateway.units import NS_PER_S

_REASON = "requested"


def keep_whole(recording: RecordingPath) -> bool:
    """Have the recorder never remove it; False where that is so already."""
    path = recording.path / layout.KEEP_FILE
    try:
        layout.write_new(path, b"")
    except FileExistsError:
        return False
    except OSError as error:
        raise write_error(error, path) from error
    return True


def keep_part(
    folder: RecordingFolder, drive: RecordingPath, begin_ns: int, end_ns: int, reason: str
) -> RecordingPath:
    """Make an incident, which the recorder never removes, of the segments in that time.

    Hard links: it takes no room while the drive is there. Both stamps are of the wall clock.
    What lies outside the recording is left out. DataError where nothing was recorded then.
    """
    chosen = [
        (segment, first_ns, last_ns)
        for segment, first_ns, last_ns in segment_times(drive.path)
        if first_ns <= end_ns and last_ns >= begin_ns
    ]
    links = [
        path
        for segment, _, _ in chosen
        for path in (*segment.paths, *signature.link_paths(drive.path, segment.number))
        if path.exists()
    ]
    if not links:
        what = "has nothing of that time"
        raise DataError(Problem(what, drive.name, "vcu-gateway recordings list, all times in UTC"))
    # Without a bound it is the drive's own: the incident says what it holds.
    begin_ns, end_ns = max(begin_ns, chosen[0][1]), min(end_ns, chosen[-1][2])
    name = layout.incident_name(begin_ns, _REASON)
    path = layout.free_path(folder.path / layout.INCIDENTS / name)
    try:
        files = _incident_files(drive, begin_ns, end_ns, reason, links)
        layout.create_folder(path, files, links)
    except OSError as error:
        raise write_error(error, path) from error
    return RecordingPath("incident", path)


def segment_times(drive: Path) -> list[tuple[SegmentFiles, int, int]]:
    """Segments of a drive with their first and last moment, wall clock; unreadable ones left out.

    A segment lasts until the next one begins, the last until its last readable lines.
    """
    begun = [
        (segment, begin.wall_ns)
        for segment in layout.segments(drive)
        if (begin := read_begin(segment.core)) is not None
    ]
    ends = [wall_ns for _, wall_ns in begun[1:]]
    if begun:
        last, wall_ns = begun[-1]
        last_s = last_second(last.core) if last.core is not None else None
        ends.append(max(wall_ns, (last_s or 0) * NS_PER_S))
    return [(segment, begin, end) for (segment, begin), end in zip(begun, ends, strict=True)]


def _incident_files(
    drive: RecordingPath, begin_ns: int, end_ns: int, reason: str, links: list[Path]
) -> dict[str, bytes]:
    """Description, copies of the drive's own, and the mark that it stays."""
    described = layout.read_description(drive.path / layout.DRIVE_FILE)
    incident = {
        "reason": _REASON,
        "kind": _REASON,
        "what": reason,
        "at": utc(begin_ns, "%Y-%m-%dT%H:%M:%S+00:00"),
        "at_ns": begin_ns,
        "before_s": 0,
        "after_s": (end_ns - begin_ns) / NS_PER_S,
        "drive": drive.name,
    }
    beside = [drive.path / name for name in layout.FILES_BESIDE]
    copies = {path.name: path.read_bytes() for path in beside if path.exists()}
    return {
        layout.INCIDENT_FILE: layout.incident_bytes(incident, described, links, copies),
        layout.KEEP_FILE: b"",
        **copies,
    }
