"""Status file: how the recorder does, once a second; for `doctor` and the exporter."""

import contextlib
import json
import os
import time
from collections import deque
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from vcu_gateway import __version__
from vcu_gateway.recorder.backlog import Backlog
from vcu_gateway.recorder.connection import GatewayConnection
from vcu_gateway.recorder.disk import Disk
from vcu_gateway.recorder.options import RecorderOptions
from vcu_gateway.recorder.ring import free_bytes, total_bytes
from vcu_gateway.recorder.senders import Refusals
from vcu_gateway.recorder.writer import Writer

FORMAT = 1
_RATE_S = 60


class StatusFile:
    """Writes the status; its folder is on a tmpfs, so that this never waits for a disk.

    Attributes:
        path: where it is; None: it is not written.
    """

    def __init__(
        self,
        options: RecorderOptions,
        writer: Writer,
        backlog: Backlog,
        disk: Disk,
        refusals: Refusals,
    ) -> None:
        self.path = options.status_path
        self._options = options
        self._writer = writer
        self._backlog = backlog
        self._disk = disk
        self._refusals = refusals
        self._started_wall_ns = time.time_ns()
        self._written: deque[tuple[float, int]] = deque([(time.monotonic(), 0)], _RATE_S + 1)
        self._space: Mapping[str, int] = {}

    def write(self, connections: Iterable[GatewayConnection]) -> None:
        """Write it anew; where that cannot be, the old one stays and tells its age."""
        if self.path is None:
            return
        text = json.dumps(self._status(connections)).encode() + b"\n"
        with contextlib.suppress(OSError):
            _replace(self.path, text)

    def _status(self, connections: Iterable[GatewayConnection]) -> dict[str, Any]:
        options, writer, disk = self._options, self._writer, self._disk
        totals = writer.totals
        return {
            "format": FORMAT,
            "pid": os.getpid(),
            "version": __version__,
            "started_wall_ns": self._started_wall_ns,
            "written_wall_ns": time.time_ns(),
            "written_monotonic_ns": time.monotonic_ns(),
            "folder": os.path.abspath(options.folder),
            "filesystem": self._filesystem(),
            "max_bytes": options.max_bytes,
            "keep_free_bytes": options.keep_free_bytes,
            "incident_max_bytes": options.incident_max_bytes,
            "drives_bytes": writer.drives_bytes,
            "incidents_bytes": writer.incidents.size,
            "incidents": writer.incidents.count,
            "disk": disk.state,
            "last_error": disk.last_error,
            "sync_seconds": {"last": totals.last_sync_s, "max_minute": totals.longest_sync_s},
            "memory": {"bytes": self._backlog.size, "max_bytes": options.memory_bytes},
            "totals": self._totals(),
            "refused": dict(self._refusals.counts),
            "bytes_a_second": self._rate(),
            "connections": [_connection(one, writer) for one in connections if one.hello],
        }

    def _totals(self) -> dict[str, int]:
        totals, writer = self._writer.totals, self._writer
        return {
            "bytes": totals.bytes,
            "frames": totals.frames,
            "ticks": totals.ticks,
            "gaps": totals.gaps,
            "frames_lost": totals.frames_lost,
            "ticks_lost": totals.ticks_lost,
            "syncs": totals.syncs,
            "sync_failures": totals.sync_failures,
            "signing_failures": 0 if writer.signer is None else writer.signer.failures,
            "removed_segments": writer.ring.removed,
            "removed_incidents": writer.incidents.removed,
        }

    def _filesystem(self) -> Mapping[str, int]:
        """Room of the file system; the last known one while the disk does not answer."""
        if self._disk.state == "ok":
            with contextlib.suppress(OSError):
                folder = self._options.folder
                self._space = {
                    "total_bytes": total_bytes(folder),
                    "free_bytes": free_bytes(folder),
                }
        return self._space

    def _rate(self) -> float:
        now_s, size = time.monotonic(), self._writer.totals.bytes
        self._written.append((now_s, size))
        then_s, before = self._written[0]
        return round((size - before) / max(1e-3, now_s - then_s), 1)


def _connection(connection: GatewayConnection, writer: Writer) -> dict[str, Any]:
    hello = connection.hello or {}
    drive = writer.drives.get(connection)
    return {
        "channel": hello.get("channel"),
        "run": hello.get("run"),
        "drive": None if drive is None else drive.folder.name,
        "segment": None if drive is None or drive.segment is None else drive.segment.number,
        "frames_handed_on": connection.frames,
        "since_wall_ns": connection.since_wall_ns,
        "last_datagram_wall_ns": connection.last_wall_ns,
    }


def _replace(path: Path, data: bytes) -> None:
    """Readers see the old text or the new one."""
    new = path.with_name(f".{path.name}.new")
    new.write_bytes(data)
    new.chmod(0o644)
    new.replace(path)
