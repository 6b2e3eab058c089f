"""Status of the running recorder: written by it once a second as a file of one JSON object.

    {"format":1,"pid":4711,...,"memory":{"bytes":4096,"max_bytes":33554432},"totals":{...},...}

The file lies in /run: one that is older than some seconds is of a recorder that hangs or is gone.
"""

import json
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.errors import DataError, NotPermittedError, Problem, UnavailableError
from vcu_gateway.units import NS_PER_S

FORMAT = 1
STATUS_PATH = Path("/run/vcu-gateway-recorder/status.json")
STALE_S = 10.0

_ROOM = "filesystem"
_PLACES = {
    "total_bytes": (_ROOM, "total_bytes"),
    "free_bytes": (_ROOM, "free_bytes"),
    "last_sync_s": ("sync_seconds", "last"),
    "longest_sync_s": ("sync_seconds", "max_minute"),
    "waiting_bytes": ("memory", "bytes"),
    "memory_bytes": ("memory", "max_bytes"),
}
"""Where fields stand in the JSON object that do not stand there by their own names."""


class RecordedConnection(NamedTuple):
    """A gateway that is connected, its folder and the segment being written, None before the first.

    Frames that it handed on are since it started, lost ones counted.
    """

    channel: str
    run: str
    drive: str | None
    segment: int | None = None
    frames_handed_on: int = 0
    since_wall_ns: int = 0
    last_datagram_wall_ns: int = 0


@dataclass(slots=True)
class RecorderTotals:
    """Counts since the recorder's start; written by its writer's thread, read by any.

    Attributes:
        bytes: of members written, both files.
        gaps, frames_lost, ticks_lost: told in the recordings.
        syncs, sync_failures: calls of fdatasync for one segment.
        removed_segments, removed_incidents: gone for want of room.
    """

    bytes: int = 0
    frames: int = 0
    ticks: int = 0
    gaps: int = 0
    frames_lost: int = 0
    ticks_lost: int = 0
    syncs: int = 0
    sync_failures: int = 0
    signing_failures: int = 0
    removed_segments: int = 0
    removed_incidents: int = 0


class RecorderStatus(NamedTuple):
    """State of the recorder, in the order of the file.

    Attributes:
        total_bytes, free_bytes: of its file system, for its user; None before they are known.
        drives_bytes, incidents_bytes: on the disk now; what both have counts as the drives'.
        disk: "ok", "full", "failing" or "stalled".
        last_sync_s, longest_sync_s: how long fdatasync took, the longest in a minute; None before
            the first.
        waiting_bytes: in memory, not yet written; memory_bytes at most.
        bytes_a_second: mean of the last minute, or of the time since the start.
    """

    pid: int
    version: str
    started_wall_ns: int
    written_wall_ns: int
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
    last_sync_s: float | None
    longest_sync_s: float | None
    waiting_bytes: int
    memory_bytes: int
    totals: RecorderTotals
    refused: Mapping[str, int]
    bytes_a_second: float
    connections: tuple[RecordedConnection, ...]

    def age_s(self, now_ns: int | None = None) -> float:
        """How long ago it was written; `now_ns` is of the monotonic clock."""
        now_ns = time.monotonic_ns() if now_ns is None else now_ns
        return (now_ns - self.written_monotonic_ns) / NS_PER_S

    def text(self) -> str:
        """The file's JSON object, as one line."""
        values: dict[str, Any] = {"format": FORMAT}
        for name, value in self._asdict().items():
            group, key = _PLACES.get(name, (None, name))
            place = values if group is None else values.setdefault(group, {})
            if value is not None or group != _ROOM:
                place[key] = value
        values["totals"] = asdict(self.totals)
        values["connections"] = [one._asdict() for one in self.connections]
        return json.dumps(values) + "\n"


def read_status(path: Path = STATUS_PATH) -> RecorderStatus:
    """The state as it was written last.

    UnavailableError where no recorder has written one, NotPermittedError where this user may not
    read it, DataError where it is of another version.
    """
    try:
        found = json.loads(path.read_bytes())
    except PermissionError as error:
        remedy = "sudo usermod -aG vcu-gateway $USER and log in again, or use sudo"
        problem = Problem("may not be read by this user", str(path), remedy)
        raise NotPermittedError(problem) from error
    except OSError as error:
        remedy = "sudo systemctl start vcu-gateway-recorder.socket, and a gateway"
        problem = Problem("no recorder has written its state", str(path), remedy)
        raise UnavailableError(problem) from error
    except ValueError as error:
        raise DataError(Problem(f"is no JSON: {error}", str(path))) from error
    try:
        return _status(found)
    except (KeyError, TypeError) as error:
        what = f"is of another version of the recorder: {error}"
        remedy = "sudo systemctl restart vcu-gateway-recorder"
        raise DataError(Problem(what, str(path), remedy)) from error


def _status(found: dict[str, Any]) -> RecorderStatus:
    """What this version does not know is left out; KeyError for what is missing."""
    values = {}
    for name in RecorderStatus._fields:
        group, key = _PLACES.get(name, (None, name))
        values[name] = found[key] if group is None else found[group].get(key)
    counts = {one.name: values["totals"][one.name] for one in fields(RecorderTotals)}
    connections = tuple(
        RecordedConnection(**{key: one[key] for key in RecordedConnection._fields})
        for one in values["connections"]
    )
    return RecorderStatus(
        **values | {"totals": RecorderTotals(**counts), "connections": connections}
    )
