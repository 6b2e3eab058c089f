"""Status file: how the recorder does, once a second; for `doctor` and the exporter."""

import contextlib
import os
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import replace

from vcu_gateway import __version__, files
from vcu_gateway.recorder.backlog import Backlog
from vcu_gateway.recorder.connection import GatewayConnection
from vcu_gateway.recorder.disk import Disk
from vcu_gateway.recorder.options import RecorderOptions
from vcu_gateway.recorder.ring import room_bytes
from vcu_gateway.recorder.senders import Refusals
from vcu_gateway.recorder.writer import Writer
from vcu_gateway.recording.recorder_status import RecordedConnection, RecorderStatus

_RATE_S = 60
_MODE = 0o644


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
        self._space: tuple[int | None, int | None] = None, None

    def write(self, connections: Iterable[GatewayConnection]) -> None:
        """Write it anew; where that cannot be, the old one stays and tells its age."""
        if self.path is None:
            return
        with contextlib.suppress(OSError):
            files.replace(self.path, self._status(connections).text(), _MODE)

    def _status(self, connections: Iterable[GatewayConnection]) -> RecorderStatus:
        options, writer, disk = self._options, self._writer, self._disk
        self._measure_space()
        signer = writer.signer
        return RecorderStatus(
            pid=os.getpid(),
            version=__version__,
            started_wall_ns=self._started_wall_ns,
            written_wall_ns=time.time_ns(),
            written_monotonic_ns=time.monotonic_ns(),
            folder=os.path.abspath(options.folder),
            total_bytes=self._space[0],
            free_bytes=self._space[1],
            max_bytes=options.max_bytes,
            keep_free_bytes=options.keep_free_bytes,
            incident_max_bytes=options.incident_max_bytes,
            drives_bytes=writer.drives_bytes,
            incidents_bytes=writer.incidents.size,
            incidents=writer.incidents.count,
            disk=disk.state,
            last_error=disk.last_error,
            last_sync_s=disk.last_sync_s,
            longest_sync_s=disk.longest_sync_s,
            waiting_bytes=self._backlog.size,
            memory_bytes=options.memory_bytes,
            totals=replace(
                writer.totals,
                signing_failures=0 if signer is None else signer.failures,
                removed_segments=writer.ring.removed,
                removed_incidents=writer.incidents.removed,
            ),
            refused=dict(self._refusals.counts),
            bytes_a_second=self._rate(),
            connections=tuple(_connection(one, writer) for one in connections if one.hello),
        )

    def _measure_space(self) -> None:
        """Room of the file system; the last known one stays while the disk does not answer."""
        if self._disk.state == "ok":
            with contextlib.suppress(OSError):
                self._space = room_bytes(self._options.folder)

    def _rate(self) -> float:
        now_s, size = time.monotonic(), self._writer.totals.bytes
        self._written.append((now_s, size))
        then_s, before = self._written[0]
        return round((size - before) / max(1e-3, now_s - then_s), 1)


def _connection(connection: GatewayConnection, writer: Writer) -> RecordedConnection:
    hello = connection.hello or {}
    drive = writer.drives.get(connection)
    return RecordedConnection(
        channel=hello["channel"],
        run=hello["run"],
        drive=None if drive is None else drive.folder.name,
        segment=None if drive is None or drive.segment is None else drive.segment.number,
        frames_handed_on=connection.frames,
        since_wall_ns=connection.since_wall_ns,
        last_datagram_wall_ns=connection.last_wall_ns,
    )
