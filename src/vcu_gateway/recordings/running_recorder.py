"""The running recorder, asked for an incident of this moment."""

import contextlib
import os
import signal
import time
from pathlib import Path

from vcu_gateway.drive_format import layout
from vcu_gateway.errors import GatewayError, NotPermittedError, Problem, UnavailableError
from vcu_gateway.recordings.folder import RecordingFolder, write_error

_PATIENCE_S = 5.0
_LOOK_EVERY_S = 0.1


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
    """No recorder runs."""
    remedy = "sudo systemctl start vcu-gateway-recorder.socket, and a gateway"
    return UnavailableError(Problem(f"no recorder runs: {why}", remedy=remedy))


def _descriptions(folder: RecordingFolder) -> set[Path]:
    incidents = layout.recorded_folders(folder.path / layout.INCIDENTS)
    return {path for incident in incidents for path in layout.incident_files(incident)}
