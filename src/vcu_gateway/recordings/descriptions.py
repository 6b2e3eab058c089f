"""Files beside the members of a recording: are they there, and what the recorder wrote?"""

import hashlib
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from vcu_gateway.drive_format import layout
from vcu_gateway.drive_format.layout import SegmentFiles
from vcu_gateway.drive_format.segment_lines import last_second
from vcu_gateway.errors import DataError, GatewayError
from vcu_gateway.recordings.checked_segment import CheckedSegment, FaultKind, FileFault
from vcu_gateway.recordings.folder import RecordingPath
from vcu_gateway.units import NS_PER_S

_KEPT_PART = "requested"
_UNTIL_WRITTEN_S = 2


def description_faults(recording: RecordingPath) -> Iterator[FileFault]:
    descriptions = layout.incident_files(recording.path)
    if recording.kind == "incident" and not descriptions:
        yield FileFault(layout.INCIDENT_FILE, "is missing", FaultKind.MISSING)
    for path in [recording.path / layout.DRIVE_FILE, *descriptions]:
        try:
            layout.read_description(path)
        except GatewayError as error:
            kind = FaultKind.CHANGED if isinstance(error, DataError) else FaultKind.MISSING
            yield FileFault(path.name, error.problems[0].what, kind)


def digest_faults(folder: Path, segment: CheckedSegment) -> Iterator[FileFault]:
    """Files that are not those that the segment's begin names, and the number that it says."""
    begin = segment.begin
    if begin is None or begin.segment is None:
        return
    core = layout.core_name(segment.number)
    if begin.segment != segment.number:
        what = f"was segment {begin.segment}, and has another number now"
        yield FileFault(core, what, FaultKind.CHANGED)
    missing = set(layout.FILES_BESIDE) - set(begin.files)
    if missing:
        what = f"does not name the digest of {', '.join(sorted(missing))}"
        yield FileFault(core, what, FaultKind.CHANGED)
    yield from _unlike(folder, begin.files, f"segment {segment.number}")


def _unlike(folder: Path, digests: Any, by: str) -> Iterator[FileFault]:
    for name, digest in digests.items() if isinstance(digests, dict) else ():
        if "/" in str(name):
            continue
        try:
            data = layout.read_small(folder / str(name))
        except FileNotFoundError:
            yield FileFault(str(name), f"is missing; {by} names it", FaultKind.MISSING)
        except OSError as error:
            what = f"cannot be read: {error.strerror or error}"
            yield FileFault(str(name), what, FaultKind.CHANGED)
        else:
            if hashlib.sha256(data).hexdigest() != digest:
                what = f"was changed: its SHA-256 is not the one that {by} names"
                yield FileFault(str(name), what, FaultKind.CHANGED)


def incident_faults(
    folder: Path, segments: list[SegmentFiles], last: CheckedSegment | None, is_chained: bool
) -> Iterator[FileFault]:
    """What an incident's descriptions say of themselves, their files and their segments.

    `last`: its last segment, checked.
    """
    there = {segment.number for segment in segments}
    core = segments[-1].core if segments else None
    ended_s = (last_second(core) if core else None) or 0
    for path in layout.incident_files(folder):
        described = layout.description_if_any(path)
        if not described or not ("digest" in described or is_chained):
            continue
        if described.get("digest") != layout.description_digest(described):
            what = "was changed: its digest is not that of what it says"
            yield FileFault(path.name, what, FaultKind.CHANGED)
            continue
        yield from _unlike(folder, described.get("files"), path.name)
        yield from _missing_segments(path.name, described, there)
        if not (last and last.end and last.end.closes):
            yield from _early_end(path.name, described, ended_s)


def _missing_segments(
    file: str, described: Mapping[str, Any], there: set[int]
) -> Iterator[FileFault]:
    try:
        first, last = (int(number) for number in described["segments"])
    except (KeyError, TypeError, ValueError, OverflowError):
        return
    missing = {first, last, *range(first, min(last, first + 9999))} - there
    if missing:
        what = (
            f"segments {min(missing)} to {max(missing)} are not there, though it was made of them"
        )
        yield FileFault(file, what, FaultKind.MISSING)


def _early_end(file: str, described: Mapping[str, Any], ended_s: int) -> Iterator[FileFault]:
    """It ends before the time that is kept after its cause, and that is over."""
    try:
        wanted_s = described["at_ns"] / NS_PER_S + described["after_s"]
    except (KeyError, TypeError, OverflowError):
        return
    kept_part = described.get("reason") == _KEPT_PART and described.get("before_s") == 0
    is_over = wanted_s + _UNTIL_WRITTEN_S < time.time()
    if is_over and not kept_part and ended_s + _UNTIL_WRITTEN_S < wanted_s:
        what = f"it ends {wanted_s - ended_s:.0f} s before the time that was to be kept"
        yield FileFault(file, what, FaultKind.MISSING)
