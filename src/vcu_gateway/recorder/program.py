"""Recorder's process: its parts, put together, and the file in which it says how it goes."""

import contextlib
import fcntl
import os
import signal
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from types import FrameType

from vcu_gateway import __version__, files
from vcu_gateway.errors import GatewayError, Problem, UnavailableError
from vcu_gateway.recorder import RecorderOptions
from vcu_gateway.recorder.connection import GatewayConnection
from vcu_gateway.recorder.receiver import DatagramReceiver
from vcu_gateway.recorder.ring import room_bytes
from vcu_gateway.recorder.senders import TapListener, trusted_users
from vcu_gateway.recorder.writer import Writer
from vcu_gateway.recording import layout
from vcu_gateway.recording.recorder_status import RecordedConnection, RecorderStatus

_RATE_S = 60


class StatusFile:
    """Writes the status; its folder is on a tmpfs, so that this never waits for a disk."""

    def __init__(self, options: RecorderOptions, writer: Writer) -> None:
        self._options = options
        self._writer = writer
        self._started_wall_ns = time.time_ns()
        self._written: deque[tuple[float, int]] = deque([(time.monotonic(), 0)], _RATE_S + 1)
        self._room: tuple[int | None, int | None] = None, None

    def write(self, connections: Iterable[GatewayConnection]) -> None:
        """Write it anew; where that cannot be, the old one stays and tells its age."""
        path = self._options.status_path
        if path is not None:
            with contextlib.suppress(OSError):
                files.replace(path, self._status(connections).text(), mode=0o644)

    def _status(self, connections: Iterable[GatewayConnection]) -> RecorderStatus:
        options, writer, disk = self._options, self._writer, self._writer.disk
        if disk.state == "ok":  # the last known room stays while the disk does not answer
            with contextlib.suppress(OSError):
                self._room = room_bytes(options.folder)
        self._written.append((time.monotonic(), writer.totals.bytes))
        (then_s, before), (now_s, after) = self._written[0], self._written[-1]
        return RecorderStatus(
            pid=os.getpid(),
            version=__version__,
            started_wall_ns=self._started_wall_ns,
            written_wall_ns=time.time_ns(),
            written_monotonic_ns=time.monotonic_ns(),
            folder=os.path.abspath(options.folder),
            total_bytes=self._room[0],
            free_bytes=self._room[1],
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
            waiting_bytes=writer.backlog.size,
            memory_bytes=options.memory_bytes,
            totals=replace(
                writer.totals,
                signing_failures=0 if writer.signer is None else writer.signer.failures,
                removed_segments=writer.ring.removed,
                removed_incidents=writer.incidents.removed,
            ),
            refused=dict(writer.refusals.counts),
            bytes_a_second=round((after - before) / max(1e-3, now_s - then_s), 1),
            connections=tuple(_connection(one, writer) for one in connections if one.hello),
        )


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


_STATUS_S = 0.95  # a little less than two waits for datagrams
_GATHER_S = 0.48
"""While nothing is urgent: ten ticks cost little more than one. A gateway ends it after what is
urgent, by a connection that is empty."""
_CALM_S = 3.0
_LAST_DATAGRAMS_S = 1.0
_LAST_WRITES_S = 3.5


class Recorder:
    """Receives in the main thread, writes in another, until SIGTERM or SIGINT.

    SIGUSR1 keeps an incident of this moment.
    """

    def __init__(self, options: RecorderOptions, say: Callable[[str], None]) -> None:
        """`say` takes a sentence for the log. UnavailableError, with what to do."""
        self._options = options
        self._say = say
        self._stop = False
        self._trusted = trusted_users(options.gateway_user)
        self._lock = _locked(options.folder)
        try:
            self._writer = Writer(options, say)
        except OSError as error:
            raise _cannot_use(options.folder, error) from error
        self._status = StatusFile(options, self._writer)

    def run(self) -> None:
        """Record until a signal; UnavailableError, and GatewayError after a bug of the writer."""
        self._wake_up = _woken_by_signals(self._on_signal)
        # After the signals: whoever finds the socket may stop the recorder, in order.
        listener = TapListener(self._options.socket_path, os.environ, os.getpid())
        writer = self._writer
        receiver = DatagramReceiver(
            listener, self._wake_up, writer.backlog, writer.wake.set, self._trusted, writer.refusals
        )
        writer.thread.start()
        self._say(f"recording into {self._options.folder}, from {listener.name}")
        try:
            self._receive(receiver)
            receiver.receive_rest(_LAST_DATAGRAMS_S)
        finally:
            listener.close()
            receiver.close()
            in_order = writer.stop(_LAST_WRITES_S)
        self._status.write(())
        if not in_order:
            self._say("the disk does not take the last seconds: they are lost")

    def _receive(self, receiver: DatagramReceiver) -> None:
        status_s = 0.0
        while not self._stop:
            now_s = time.monotonic()
            if now_s >= status_s:
                status_s = now_s + _STATUS_S
                self._writer.disk.watch()
                self._status.write(receiver.connections)
                if not self._writer.thread.is_alive():
                    raise GatewayError(Problem("the writer's thread has ended by a bug"))
            is_calm = now_s - receiver.urgent_s > _CALM_S
            # A gateway that wakes nobody hands its datagrams over sooner.
            if is_calm and receiver.connections:
                receiver.gather(_GATHER_S)
            else:
                receiver.receive(max(0.0, status_s - now_s))
            self._writer.write_if_due()

    def _on_signal(self, number: int, _: FrameType | None) -> None:
        if number == signal.SIGUSR1:
            self._writer.request_incident()
        else:
            self._stop = True


def _woken_by_signals(handler: Callable[[int, FrameType | None], None]) -> socket.socket:
    """Socket that can be read from the first SIGTERM, SIGINT or SIGUSR1 on: it ends a wait."""
    awake, wake_up = socket.socketpair()
    for sock in (awake, wake_up):
        sock.setblocking(False)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1):
        signal.signal(number, handler)
    signal.set_wakeup_fd(awake.detach(), warn_on_full_buffer=False)
    return wake_up


def _locked(folder: Path) -> int:
    """Descriptor of the folder, which is ours alone; made where it is not there."""
    try:
        for path in (folder, folder / layout.DRIVES, folder / layout.INCIDENTS):
            path.mkdir(mode=0o750, parents=True, exist_ok=True)
            layout.remove_partial_folders(path)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise _cannot_use(folder, error) from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        what = f"another recorder writes into {folder}"
        raise UnavailableError(Problem(what, remedy="give each a folder with --folder")) from error
    return descriptor


def _cannot_use(folder: Path, error: OSError) -> UnavailableError:
    what = f"cannot record into {folder}: {error.strerror or error}"
    remedy = f"it must be a folder that this user can write; look at: ls -ld {folder}"
    return UnavailableError(Problem(what, remedy=remedy))
