"""Recordings kept and removed, by the rights of their owner, also by the running recorder."""

import contextlib
import fcntl
import os
import signal
import time
from pathlib import Path

from vcu_gateway.errors import (
    DataError,
    GatewayError,
    NotPermittedError,
    Problem,
    RequestRefusedError,
    UnavailableError,
)
from vcu_gateway.recording import layout, signature
from vcu_gateway.recording.folder import RecordingFolder, RecordingPath, reading, writing
from vcu_gateway.recording.layout import SegmentFiles
from vcu_gateway.recording.recorder_status import STALE_S, STATUS_PATH, RecorderStatus, read_status
from vcu_gateway.recording.segment import last_second, read_begin
from vcu_gateway.text import utc
from vcu_gateway.units import NS_PER_S


def act_as_owner(folder: Path) -> None:
    """Give up root's rights for those of the folder's owner, for good; nothing for other users.

    What is made then belongs to the recorder, which can remove it again. And what somebody put
    into the folder, such as a link to a file of root's, is of no use to him.
    """
    if os.geteuid() != 0:
        return
    with reading(folder):
        owner = folder.stat()
    if owner.st_uid == 0:
        return
    os.umask(0o027)
    os.setgroups([])
    os.setresgid(owner.st_gid, owner.st_gid, owner.st_gid)
    os.setresuid(owner.st_uid, owner.st_uid, owner.st_uid)


def remove_recording(recording: RecordingPath) -> list[str]:
    """Remove it; the names of what is none of a recording's and stays, with the folder.

    RequestRefusedError where a recorder is writing it. A link is removed and what it points to is
    not: every name is looked up in the opened folder itself.
    """
    with writing(recording.path):
        descriptor = os.open(recording.path, layout.FOLDER_FLAGS)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            own, others = _names(descriptor, recording.path)
            for name in own:
                os.unlink(name, dir_fd=descriptor)
        except BlockingIOError as error:
            remedy = "stop it first: sudo systemctl stop vcu-gateway-recorder.socket"
            problem = Problem("is being written by the recorder", recording.name, remedy)
            raise RequestRefusedError(problem) from error
        finally:
            os.close(descriptor)
        if not others:
            recording.path.rmdir()
    return others


def _names(descriptor: int, folder: Path) -> tuple[list[str], list[str]]:
    """What belongs to a recording, its description last, and what does not."""
    found = os.listdir(descriptor)
    known = {*layout.FILES_BESIDE, layout.KEEP_FILE, *filter(signature.LINK.fullmatch, found)}
    known |= {path.name for segment in layout.segments(folder) for path in segment.paths}
    known |= {path.name for path in layout.incident_files(folder)}
    known |= {f"{name}{signature.SUFFIX}" for name in known}
    own = sorted(known & set(found), key=lambda name: (name.endswith(".json"), name))
    return own, sorted(set(found) - known)


def keep_whole(recording: RecordingPath) -> bool:
    """Have the recorder never remove it; False where that is so already."""
    path = recording.path / layout.KEEP_FILE
    with writing(path), contextlib.suppress(FileExistsError):
        layout.write_new(path, b"")
        return True
    return False


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
    name = layout.incident_name(begin_ns, layout.REQUESTED)
    path = layout.free_path(folder.path / layout.INCIDENTS / name)
    with writing(path):
        beside = [drive.path / name for name in layout.FILES_BESIDE]
        copies = {one.name: one.read_bytes() for one in beside if one.exists()}
        described = layout.read_description(drive.path / layout.DRIVE_FILE)
        cause = {"reason": layout.REQUESTED, "kind": layout.REQUESTED, "what": reason}
        when = {"at": utc(begin_ns, "%Y-%m-%dT%H:%M:%S+00:00"), "at_ns": begin_ns}
        kept = {"before_s": 0, "after_s": (end_ns - begin_ns) / NS_PER_S, "drive": drive.name}
        text = layout.incident_bytes(cause | when | kept, described, links, copies)
        files = {layout.INCIDENT_FILE: text, layout.KEEP_FILE: b"", **copies}
        layout.create_folder(path, files, links)
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
        ends.append(max(wall_ns, (last_second(last.core) or 0) * NS_PER_S))
    return [(segment, begin, end) for (segment, begin), end in zip(begun, ends, strict=True)]


def running(folder: RecordingFolder, status_path: Path | None = None) -> RecorderStatus:
    """Status of the recorder that writes into this folder now, with a gateway connected to it.

    `status_path` is where it says how it goes; None: in the folder, as the demo's recorder does, or
    where the service's does. UnavailableError where no such recorder runs.
    """
    if status_path is None:
        own = folder.path / STATUS_PATH.name
        status_path = own if own.exists() else STATUS_PATH
    status = read_status(status_path)
    if not 0 <= (age_s := status.age_s()) < STALE_S:
        since = f"{age_s:.0f} s old" if age_s > 0 else "from before this computer's start"
        raise no_recorder(f"{status_path} is {since}")
    is_here = False
    with contextlib.suppress(OSError):  # another user's, or gone
        is_here = folder.path.samefile(status.folder)
    if not is_here:
        what = f"the recorder that runs writes into {status.folder}, not here"
        remedy = "name that folder with --folder; a demo records with --record, while it runs"
        raise UnavailableError(Problem(what, str(folder.path), remedy))
    if not status.connections:
        raise no_recorder("no gateway is connected to it, so that there is nothing to keep")
    return status


def keep_now(folder: RecordingFolder, pid: int, reason: str = "") -> str | None:
    """Ask the recorder, by its process number; the incident's name, None where it takes over 5 s.

    One that is open already takes this reason in.
    """
    before = _descriptions(folder)
    file = folder.path / layout.INCIDENTS / layout.REASON_FILE
    try:
        if reason:
            with writing(file):
                file.write_text(reason)
        _signal(pid)
    except GatewayError:
        with contextlib.suppress(OSError):
            file.unlink()
        raise
    until_s = time.monotonic() + 5.0
    while time.monotonic() < until_s:
        if new := _descriptions(folder) - before:
            return max(path.parent.name for path in new)
        time.sleep(0.1)
    return None


def _signal(pid: int) -> None:
    try:
        os.kill(pid, signal.SIGUSR1)
    except ProcessLookupError as error:
        raise no_recorder(f"process {pid} is gone") from error
    except PermissionError as error:
        what = f"process {pid}, the recorder, may not be asked by this user"
        raise NotPermittedError(Problem(what, remedy="use sudo")) from error


def no_recorder(why: str) -> UnavailableError:
    remedy = "sudo systemctl start vcu-gateway-recorder.socket, and a gateway"
    return UnavailableError(Problem(f"no recorder runs: {why}", remedy=remedy))


def _descriptions(folder: RecordingFolder) -> set[Path]:
    incidents = layout.recorded_folders(folder.path / layout.INCIDENTS)
    return {path for incident in incidents for path in layout.incident_files(incident)}
