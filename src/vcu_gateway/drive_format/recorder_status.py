"""What the running recorder tells of itself, once a second, in a file of one JSON object.

The file lies in /run: one that is older than some seconds is of a recorder that hangs or is gone.
"""

import json
import time
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.errors import (
    DataError,
    GatewayError,
    NotPermittedError,
    Problem,
    UnavailableError,
)
from vcu_gateway.units import NS_PER_S

STATUS_PATH = Path("/run/vcu-gateway-recorder/status.json")
STALE_S = 10.0


class RecordedConnection(NamedTuple):
    """A gateway that is connected; `drive` is the name of its folder, None before there is one."""

    channel: str
    run: str
    drive: str | None


class RecorderStatus(NamedTuple):
    """State of the recorder; counts are since its start.

    Attributes:
        version: of the recorder.
        started_wall_ns: when it started.
        written_monotonic_ns: when this was written.
        folder: of the recordings.
        total_bytes, free_bytes: of its file system, for its user; None before they are known.
        max_bytes, keep_free_bytes, incident_max_bytes: as it was told.
        drives_bytes, incidents_bytes: on the disk now; what both have counts as the drives'.
        incidents: how many there are.
        disk: "ok", "full", "failing" or "stalled".
        last_error: of the disk; None where there was none.
        waiting_bytes: in memory, not yet written; memory_bytes at most.
        last_sync_s, longest_sync_s: how long fdatasync took, the longest in a minute; None before
            the first.
        bytes: written.
        bytes_a_second: mean of the last minute, or of the time since the start.
        frames, ticks: recorded.
        gaps, frames_lost, ticks_lost: told in the recordings.
        syncs, sync_failures: calls of fdatasync.
        signing_failures: signatures that could not be made.
        removed_segments, removed_incidents: gone for want of room.
        connections: the gateways.
    """

    pid: int
    version: str
    started_wall_ns: int
    written_monotonic_ns: int
    folder: str
    total_bytes: int | None
    free_bytes: int | None
    max_bytes: int
    keep_free_bytes: int
    incident_max_bytes: int
    drives_bytes: int
    incidents_bytes: int
    incidents: int
    disk: str
    last_error: str | None
    waiting_bytes: int
    memory_bytes: int
    last_sync_s: float | None
    longest_sync_s: float | None
    bytes: int
    bytes_a_second: float
    frames: int
    ticks: int
    gaps: int
    frames_lost: int
    ticks_lost: int
    syncs: int
    sync_failures: int
    signing_failures: int
    removed_segments: int
    removed_incidents: int
    connections: tuple[RecordedConnection, ...]

    def age_s(self, now_ns: int | None = None) -> float:
        """How long ago it was written; `now_ns` is of the monotonic clock."""
        now_ns = time.monotonic_ns() if now_ns is None else now_ns
        return (now_ns - self.written_monotonic_ns) / NS_PER_S


def read_status(path: Path = STATUS_PATH) -> RecorderStatus:
    """The state as it was written last.

    UnavailableError where no recorder has written one, NotPermittedError where this user may not
    read it, DataError where it is of another version.
    """
    try:
        found = json.loads(path.read_bytes())
    except OSError as error:
        raise _unreadable(path, error) from error
    except ValueError as error:
        raise DataError(Problem(f"is no JSON: {error}", str(path))) from error
    try:
        return _status(found)
    except (KeyError, TypeError) as error:
        what = f"is of another version of the recorder: {error}"
        remedy = "sudo systemctl restart vcu-gateway-recorder"
        raise DataError(Problem(what, str(path), remedy)) from error


def _unreadable(path: Path, error: OSError) -> GatewayError:
    if isinstance(error, PermissionError):
        remedy = "sudo usermod -aG vcu-gateway $USER and log in again, or use sudo"
        return NotPermittedError(Problem("may not be read by this user", str(path), remedy))
    remedy = "sudo systemctl start vcu-gateway-recorder.socket, and a gateway"
    return UnavailableError(Problem("no recorder has written its state", str(path), remedy))


def _status(found: dict[str, Any]) -> RecorderStatus:
    """What this version does not know is left out; KeyError for what is missing."""
    sync, memory, room = found["sync_seconds"], found["memory"], found["filesystem"]
    flat = {
        **found,
        **found["totals"],
        "last_sync_s": sync["last"],
        "longest_sync_s": sync["max_minute"],
        "waiting_bytes": memory["bytes"],
        "memory_bytes": memory["max_bytes"],
        "total_bytes": room.get("total_bytes"),
        "free_bytes": room.get("free_bytes"),
        "connections": tuple(
            RecordedConnection(one["channel"], one["run"], one["drive"])
            for one in found["connections"]
        ),
    }
    return RecorderStatus(**{name: flat[name] for name in RecorderStatus._fields})
