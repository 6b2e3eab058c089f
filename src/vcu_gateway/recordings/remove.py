"""Removing a recording: its own files, in its own folder, and nothing else."""

import fcntl
import os
from pathlib import Path

from vcu_gateway.drive_format import layout, lock, signature
from vcu_gateway.errors import Problem, RequestRefusedError
from vcu_gateway.recordings.folder import RecordingPath, write_error


def remove_recording(recording: RecordingPath) -> list[str]:
    """Remove it; the names of what is none of a recording's and stays, with the folder.

    RequestRefusedError where a recorder is writing it. A link is removed and what it points to is
    not: every name is looked up in the opened folder itself.
    """
    try:
        descriptor = os.open(recording.path, lock.FOLDER_FLAGS)
        try:
            _refuse_written(descriptor, recording)
            own, others = _names(descriptor, recording.path)
            for name in own:
                os.unlink(name, dir_fd=descriptor)
        finally:
            os.close(descriptor)
        if not others:
            recording.path.rmdir()
    except OSError as error:
        raise write_error(error, recording.path) from error
    return others


def _refuse_written(descriptor: int, recording: RecordingPath) -> None:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        remedy = "stop it first: sudo systemctl stop vcu-gateway-recorder.socket"
        problem = Problem("is being written by the recorder", recording.name, remedy)
        raise RequestRefusedError(problem) from error


def _names(descriptor: int, folder: Path) -> tuple[list[str], list[str]]:
    """What belongs to a recording, its description last, and what does not."""
    found = os.listdir(descriptor)
    known = {*layout.FILES_BESIDE, layout.KEEP_FILE}
    known |= {path.name for segment in layout.segments(folder) for path in segment.paths}
    known |= {path.name for path in layout.incident_files(folder)}
    known |= {name for name in found if signature.is_link(name)}
    known |= {f"{name}{signature.SUFFIX}" for name in known}
    own = sorted(known & set(found), key=lambda name: (name.endswith(".json"), name))
    return own, sorted(set(found) - known)
