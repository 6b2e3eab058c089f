"""Check of a recording: is each piece of it there, and what the recorder wrote?

Every member is read, and the chain is followed from the first to the closing record: a member that
was changed, removed or added breaks it, and the files beside the members are named in it. Who made
a whole chain anew is found by a signature only; without one the recording is unsigned.

What a chain cannot show is counted: received = recorded + gaps. Before each segment the recorder
notes how many frames and ticks the gateway had handed on, and what of them it did not get. So
between the beginnings of two segments each is in a file, or in a gap, or it is missing. And each
command is there twice, as it was sent and as the bus gave it back.
"""

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from vcu_gateway.errors import DataError, GatewayError
from vcu_gateway.recording import layout
from vcu_gateway.recording.chain import FaultKind, FileFault, follow
from vcu_gateway.recording.checked_segment import CheckedSegment, EchoCheck, check_segment
from vcu_gateway.recording.folder import RecordingPath, reading
from vcu_gateway.recording.layout import SegmentFiles
from vcu_gateway.recording.segment import Losses, last_second
from vcu_gateway.recording.signature import Signatures, check_signatures
from vcu_gateway.units import NS_PER_S

_UNTIL_WRITTEN_S = 2


def _description_faults(recording: RecordingPath) -> Iterator[FileFault]:
    descriptions = layout.incident_files(recording.path)
    if recording.kind == "incident" and not descriptions:
        yield FileFault(layout.INCIDENT_FILE, "is missing", FaultKind.MISSING)
    for path in [recording.path / layout.DRIVE_FILE, *descriptions]:
        try:
            layout.read_description(path)
        except GatewayError as error:
            kind = FaultKind.CHANGED if isinstance(error, DataError) else FaultKind.MISSING
            yield FileFault(path.name, error.problems[0].what, kind)


def _digest_faults(folder: Path, segment: CheckedSegment) -> Iterator[FileFault]:
    """Files that are not those that the segment's begin names, and the number that it says."""
    begin = segment.begin
    if begin is None or begin.segment is None:
        return
    core = layout.core_name(segment.number)
    if begin.segment != segment.number:
        what = f"was segment {begin.segment}, and has another number now"
        yield FileFault(core, what, FaultKind.CHANGED)
    if missing := set(layout.FILES_BESIDE) - set(begin.files):
        what = f"does not name the digest of {', '.join(sorted(missing))}"
        yield FileFault(core, what, FaultKind.CHANGED)
    yield from _unlike(folder, begin.files, f"segment {segment.number}")


def _unlike(folder: Path, digests: Any, by: str) -> Iterator[FileFault]:
    for name, digest in digests.items() if isinstance(digests, dict) else ():
        if "/" in str(name):
            continue
        kind = FaultKind.CHANGED
        try:
            data = layout.read_small(folder / str(name))
        except FileNotFoundError:
            kind, what = FaultKind.MISSING, f"is missing; {by} names it"
        except OSError as error:
            what = f"cannot be read: {error.strerror or error}"
        else:
            if hashlib.sha256(data).hexdigest() == digest:
                continue
            what = f"was changed: its SHA-256 is not the one that {by} names"
        yield FileFault(str(name), what, kind)


def _incident_faults(
    folder: Path, segments: list[SegmentFiles], is_closed: bool, is_chained: bool
) -> Iterator[FileFault]:
    """What an incident's descriptions say of themselves, their files and their segments."""
    there = {segment.number for segment in segments}
    core = segments[-1].core if segments else None
    ended_s = last_second(core) or 0
    for path in layout.incident_files(folder):
        described = layout.description_if_any(path)
        if not described or not ("digest" in described or is_chained):
            continue
        if described.get("digest") != layout.description_digest(described):
            what = "was changed: its digest is not that of what it says"
            yield FileFault(path.name, what, FaultKind.CHANGED)
            continue
        yield from _unlike(folder, described.get("files"), path.name)
        missing = [_missing_segments(described, there)]
        if not is_closed:
            missing.append(_early_end(described, ended_s))
        yield from (FileFault(path.name, what, FaultKind.MISSING) for what in missing if what)


def _missing_segments(described: Mapping[str, Any], there: set[int]) -> str | None:
    try:
        first, last = (int(number) for number in described["segments"])
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    missing = {first, last, *range(first, min(last, first + 9999))} - there
    if not missing:
        return None
    return f"segments {min(missing)} to {max(missing)} are not there, though it was made of them"


def _early_end(described: Mapping[str, Any], ended_s: int) -> str | None:
    """It ends before the time that is kept after its cause, and that is over."""
    try:
        wanted_s = described["at_ns"] / NS_PER_S + described["after_s"]
    except (KeyError, TypeError, OverflowError):
        return None
    kept_part = described.get("reason") == layout.REQUESTED and described.get("before_s") == 0
    is_over = wanted_s + _UNTIL_WRITTEN_S < time.time()
    if kept_part or not is_over or ended_s + _UNTIL_WRITTEN_S >= wanted_s:
        return None
    return f"it ends {wanted_s - ended_s:.0f} s before the time that was to be kept"


class RecordingState(Enum):
    """What a recording is, as far as its files show; the worst that was found."""

    WHOLE = "whole"
    WRITTEN = "being written, whole so far"
    INCOMPLETE = "INCOMPLETE"
    CHANGED = "CHANGED OR DAMAGED"


@dataclass
class CheckedRecording:
    """What a check found, so far.

    Attributes:
        frames, ticks: recorded and readable.
        gaps: what the recorder did not get, as it says itself.
        missing_frames, missing_ticks: received, and neither recorded nor in a gap.
        is_cut_off: it ends without a closing record.
        is_written: a recorder is writing it; then its end is not judged.
        is_chained: False for one of an older recorder: nothing shows whether it was changed.
    """

    name: str
    segments: int
    frames: int = 0
    ticks: int = 0
    gaps: Losses = field(default_factory=Losses)
    missing_frames: int = 0
    missing_ticks: int = 0
    is_cut_off: bool = False
    is_written: bool = False
    is_chained: bool = False
    signatures: Signatures = field(default_factory=Signatures)
    faults: list[FileFault] = field(default_factory=list)

    @property
    def state(self) -> RecordingState:
        """The worst of what was found; a torn end, behind which the recorder went on, is none."""
        kinds = {fault.kind for fault in self.faults}
        if FaultKind.CHANGED in kinds:
            return RecordingState.CHANGED
        if FaultKind.MISSING in kinds or self.missing_frames or self.missing_ticks:
            return RecordingState.INCOMPLETE
        return RecordingState.WRITTEN if self.is_written else RecordingState.WHOLE

    @property
    def is_whole(self) -> bool:
        return self.exit_code == 0

    @property
    def exit_code(self) -> int:
        """0 whole, 3 incomplete, 65 changed or damaged."""
        return {RecordingState.INCOMPLETE: 3, RecordingState.CHANGED: 65}.get(self.state, 0)


def check_recording(
    recording: RecordingPath,
    progress: Callable[[int], object],
    allowed_signers: Path | None = None,
) -> CheckedRecording:
    """Read it whole; `progress` is called with the bytes of each segment.

    With allowed signers, what none of them has signed is a fault. What cannot be read of a file is
    a fault of the result; NotPermittedError or MissingInputError where the folder cannot be read,
    UnavailableError where there are signatures and no ssh-keygen.
    """
    folder, is_incident = recording.path, recording.kind == "incident"
    with reading(folder):
        is_written = layout.is_held(folder)
        segments = layout.segments(folder)
        found = CheckedRecording(recording.name, len(segments), is_written=is_written)
        found.faults += _description_faults(recording)
        # Before the members are read: of a drive that is being written, more come meanwhile.
        found.is_chained, ends, breaks = follow(segments, is_part=is_incident)
        check = _SegmentCheck(found)
        for segment in segments:
            checked = check_segment(segment)
            if is_written and segment is segments[-1]:
                checked.faults.clear()
            check.add(checked)
            found.faults += _digest_faults(folder, checked)
            progress(sum(path.lstat().st_size for path in segment.paths))
        last = check.last
        _add_breaks(found, breaks, last)
        if not is_written:
            check.end(is_drive=not is_incident)
        if is_incident:
            is_closed = last is not None and last.is_closed
            found.faults += _incident_faults(folder, segments, is_closed, found.is_chained)
        signer, faults = check.signer, found.faults
        found.signatures = check_signatures(folder, ends, signer, allowed_signers, faults)
    return found


def _add_breaks(
    found: CheckedRecording, breaks: list[FileFault], last: CheckedSegment | None
) -> None:
    """Add faults of the chain in files of which nothing worse is known.

    What only looked torn is what the chain says: something went on behind it. A power cut may
    leave the later one of two members, but only in a last segment that was not ended.
    """
    unended: tuple[str, ...] = ()
    if last is not None and last.end is None:
        unended = (layout.core_name(last.number), layout.frames_name(last.number))
    faults = found.faults
    for one in breaks:
        of_file = [number for number, fault in enumerate(faults) if fault.file == one.file]
        torn = [number for number in of_file if faults[number].kind is FaultKind.TORN]
        if one.kind is not FaultKind.TORN and torn:
            kind = FaultKind.MISSING if one.file in unended else one.kind
            faults[torn[0]] = faults[torn[0]]._replace(kind=kind)
        elif not of_file and not (found.is_written and one.kind is FaultKind.TORN):
            faults.append(one)


class _SegmentCheck:
    """Adds up the segments of a recording, each compared with the last one.

    `signer` is the fingerprint of the key that its recorder says to sign with; None without one.
    """

    def __init__(self, found: CheckedRecording) -> None:
        self.last: CheckedSegment | None = None
        self.signer: str | None = None
        self._found = found
        self._echoes = EchoCheck()

    def add(self, one: CheckedSegment) -> None:
        found, before = self._found, self.last
        if before is not None:
            self._compare(before, one)
        follows = before is not None and one.number == before.number + 1 and not before.faults
        if one.begin is not None:
            found.gaps += one.begin.gap
            follows &= not one.begin.gap.gaps
            self.signer = one.begin.signer or self.signer
        for echo in self._echoes.segment(one.commands, one.echoes, follows):
            what = f"line {echo.place + 1}: {echo.identifier}#{echo.data} is no command that was"
            self._fault(layout.frames_name(one.number), f"{what} sent", FaultKind.CHANGED)
        found.frames += one.frames
        found.ticks += one.ticks
        found.faults += one.faults
        self.last = one

    def _compare(self, before: CheckedSegment, one: CheckedSegment) -> None:
        if one.number != before.number + 1:
            what = f"segments between {before.number} and {one.number} are missing"
            self._fault(layout.frames_name(one.number), what, FaultKind.MISSING)
        elif before.begin is None or one.begin is None:
            self._found.missing_frames += before.unread_frames
        else:
            begun, begins, gap = before.begin, one.begin, one.begin.gap
            frames = begins.frames - begun.frames - before.frames - gap.frames
            self._found.missing_frames += self._missing(one, frames, "frames")
            if begun.segment is not None and begins.segment is not None:
                ticks = begins.ticks - begun.ticks - before.ticks - gap.ticks
                self._found.missing_ticks += self._missing(one, ticks, "ticks")

    def _missing(self, one: CheckedSegment, count: int, unit: str) -> int:
        """How many are missing; more than was handed on is as wrong as less."""
        if count < 0:
            what = f"{-count} {unit} more are recorded before it than the gateway handed on"
            self._fault(layout.core_name(one.number), what, FaultKind.CHANGED)
        return max(0, count)

    def end(self, is_drive: bool) -> None:
        """Judge the end: what its own lines count has to be there, and a closing record.

        Of one that was not ended, a torn end tells no number.
        """
        last = self.last
        if last is None:
            self._fault("", "has no segment", FaultKind.MISSING)
            return
        is_torn = any(fault.kind is FaultKind.TORN for fault in last.faults)
        if last.end is not None or not is_torn:
            self._found.missing_frames += last.unread_frames
        self._found.is_cut_off = not last.is_closed
        if is_drive and not last.is_closed:
            what = "ends without a closing record: the recorder was killed, the power failed, or"
            what += " its end was removed"
            if last.end is not None:
                what = f"nothing comes after it, and it does not close the drive: {last.end.why}"
            self._fault(layout.core_name(last.number), what, FaultKind.MISSING)

    def _fault(self, file: str, what: str, kind: FaultKind) -> None:
        self._found.faults.append(FileFault(file, what, kind))


def headline(found: CheckedRecording) -> str:
    """The state, and what proves it."""
    if not found.is_chained:
        return f"{found.state.value}, not chained: nothing shows whether it was changed"
    signed = found.signatures
    if not signed.signers:
        return f"{found.state.value}, chained, unsigned"
    part = "" if signed.segments == found.segments else f" {signed.segments} segments"
    return f"{found.state.value}, chained, signed{part} by {', '.join(signed.signers)}"


def fault_lines(found: CheckedRecording, most: int) -> Iterator[str]:
    for fault in found.faults[:most]:
        yield f"  {fault.file}: {fault.what}" if fault.file else f"  {fault.what}"
    if len(found.faults) > most:
        yield f"  and {len(found.faults) - most} more"


def values(found: CheckedRecording) -> dict[str, Any]:
    return {
        **vars(found),
        "state": found.state.name.lower(),
        "is_whole": found.is_whole,
        "gaps": found.gaps._asdict(),
        "signatures": found.signatures._asdict(),
        "faults": [{**one._asdict(), "kind": one.kind.value} for one in found.faults],
    }
