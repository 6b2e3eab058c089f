"""The running recorder, asked for an incident of this moment."""

import contextlib
import os
import signal
import time
from pathlib import Path

from vcu_gateway.drive_format import layout
from vcu_gateway.drive_format.recorder_status import (
    STALE_S,
    STATUS_PATH,
    RecorderStatus,
    read_status,
)
from vcu_gateway.errors import GatewayError, NotPermittedError, Problem, UnavailableError
from vcu_gateway.recordings.folder import RecordingFolder, write_error

_PATIENCE_S = 5.0
_LOOK_EVERY_S = 0.1


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
    if not _is_same(Path(status.folder), folder.path):
        what = f"the recorder that runs writes into {status.folder}, not here"
        remedy = "name that folder with --folder; a demo records with --record, while it runs"
        raise UnavailableError(Problem(what, str(folder.path), remedy))
    if not status.connections:
        raise no_recorder("no gateway is connected to it, so that there is nothing to keep")
    return status


def _is_same(one: Path, other: Path) -> bool:
    try:
        return one.samefile(other)
    except OSError:  # another user's, or gone
        return False


def keep_now(folder: RecordingFolder, pid: int, reason: str = "") -> str | None:
    """Ask the recorder, by its process number; the incident's name, None where it takes longer.

    One that is open already takes this reason in.
    """
    before = _descriptions(folder)
    file = folder.path / layout.INCIDENTS / layout.REASON_FILE
    try:
        if reason:
            _write(file, reason)
        _signal(pid)
    except GatewayError:
        with contextlib.suppress(OSError):
            file.unlink()
        raise
    until_s = time.monotonic() + _PATIENCE_S
    while time.monotonic() < until_s:
        if new := _descriptions(folder) - before:
            return max(path.parent.name for path in new)
        time.sleep(_LOOK_EVERY_S)
    return None


def _write(file: Path, reason: str) -> None:
    try:
        file.write_text(reason)
    except OSError as error:
        raise write_error(error, file) from error


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
