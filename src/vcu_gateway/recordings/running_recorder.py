"""The running recorder, asked for an incident of this moment."""

import os
import signal
import time

from vcu_gateway.drive_format import layout
from vcu_gateway.errors import NotPermittedError, Problem, UnavailableError
from vcu_gateway.recordings.folder import RecordingFolder

_PATIENCE_S = 5.0
_LOOK_EVERY_S = 0.1


def keep_now(folder: RecordingFolder, pid: int) -> str | None:
    """Ask the recorder, by its process number; the incident's name, None where it takes longer."""
    before = _incidents(folder)
    try:
        os.kill(pid, signal.SIGUSR1)
    except ProcessLookupError as error:
        raise no_recorder(f"process {pid} is gone") from error
    except PermissionError as error:
        what = f"process {pid}, the recorder, may not be asked by this user"
        raise NotPermittedError(Problem(what, remedy="use sudo")) from error
    until_s = time.monotonic() + _PATIENCE_S
    while time.monotonic() < until_s:
        if new := _incidents(folder) - before:
            return max(new)
        time.sleep(_LOOK_EVERY_S)
    return None


def no_recorder(why: str) -> UnavailableError:
    """No recorder runs."""
    remedy = "sudo systemctl start vcu-gateway-recorder.socket, and a gateway"
    return UnavailableError(Problem(f"no recorder runs: {why}", remedy=remedy))


def _incidents(folder: RecordingFolder) -> set[str]:
    return {path.name for path in layout.recorded_folders(folder.path / layout.INCIDENTS)}
