"""Tap's socket: a datagram a tick to the recorder, where one listens; never waited for.

A recorder that is not there is looked for once a second, and told by a HELLO what it has to know.
One that does not keep up loses datagrams, which are counted; as soon as the socket has room again a
checkpoint tells where the recording goes on.
"""

import contextlib
import errno
import os
import select
import socket
import time
from collections.abc import Callable
from pathlib import Path

from vcu_gateway import config as configuration
from vcu_gateway.bus.settings import read_clocks
from vcu_gateway.config import Config
from vcu_gateway.config.checks import dbc_path
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.gateway import TickResult
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.daemon.reload import Reloader
from vcu_gateway.daemon.restart_state import boot_id
from vcu_gateway.recording import datagram
from vcu_gateway.recording.core_lines import ShellEvent
from vcu_gateway.recording.layout import DBC_FILE
from vcu_gateway.recording.tap import Hello, TappedGateway, TapStream, packed_frames
from vcu_gateway.units import NS_PER_MS, NS_PER_S

_CONNECT_EVERY_NS = NS_PER_S
_CHECKPOINT_EVERY_NS = 60 * NS_PER_S
_CHECKPOINT_FRAMES = 1_000_000
# After a lost datagram: a checkpoint costs some milliseconds, and one in every tick would be much.
_CHECKPOINT_AGAIN_NS = 250 * NS_PER_MS
# Ten seconds of ordinary traffic, where the kernel allows it (net.core.wmem_max).
_SEND_BUFFER_BYTES = 1 << 20


class RecorderTap:
    """Hands what a tapped gateway was given and answered to the recorder; for the ticking thread.

    Run id and clocks of its HELLO are those of its making; `digest` is that of the DBC.

    Attributes:
        datagrams: handed over since the start.
        lost_datagrams, lost_frames: those that a connected recorder missed.
    """

    def __init__(
        self, path: Path, gateway: TappedGateway, loop: TickLoop, reloader: Reloader, digest: str
    ) -> None:
        self._path = str(path)
        self._gateway = gateway
        self._loop = loop
        self._reloader = reloader
        self._dbc = dbc_path(reloader.config).read_bytes().decode()
        self._dbc_digest = digest
        self._run, self._boot, self._clock = os.urandom(16).hex(), boot_id(), read_clocks()
        self._written: tuple[Config, str, str] | None = None
        self._stream = TapStream(gateway)
        self._socket: socket.socket | None = None
        self._poll = select.poll()
        self._recording = self._failed = False
        self._connect_ns = self._checkpoint_ns = 0
        self.datagrams = self.lost_datagrams = self.lost_frames = 0
        self._event_log = loop.event_log
        self._event_log.subscribe(self._note_event)

    @property
    def connected(self) -> bool:
        return self._socket is not None

    def begin(self) -> None:
        """Look for the recorder before the first tick: a drive is to have its beginning. Once."""
        if self._connect_ns == 0:
            self._guarded(self._look, time.monotonic_ns())

    def observe(self, result: TickResult) -> None:
        self._guarded(self._after_tick, result.snapshot.now_ns)

    def close(self) -> None:
        if self._socket is not None and self._recording:
            self._guarded(self._hand_on)
        self._drop_socket()

    def _guarded(self, act: Callable[..., None], *arguments: int) -> None:
        """A bug of the recording is an event, and ends the recording: the vehicle goes on."""
        if self._failed:
            self._stream.skip()
            return
        try:
            act(*arguments)
        except Exception as error:  # noqa: BLE001
            self._failed = True
            self._drop_socket()
            self._event_log.emit(Event("recording_failed", Severity.ERROR, {"reason": repr(error)}))

    def _after_tick(self, now_ns: int) -> None:
        if self._socket is None:
            self._stream.skip()
            if now_ns >= self._connect_ns:
                self._look(now_ns)
        elif self._recording:
            latest = self._loop.latest
            if latest is not None:
                self._stream.note_why(now_ns, latest.why_signature)
            self._hand_on()
            many = self._stream.writer.frames >= _CHECKPOINT_FRAMES
            if self._recording and (many or now_ns >= self._checkpoint_ns):
                self._begin_segment(now_ns)
        else:
            self._count_lost(self._stream.skip())
            if now_ns >= self._checkpoint_ns and self._poll.poll(0):
                self._begin_segment(now_ns)

    def _hand_on(self) -> None:
        frames, lines = self._stream.batch()
        counts = self._stream.frames, self.lost_datagrams, self.lost_frames
        header = datagram.TickHeader(self.datagrams + self.lost_datagrams + 1, *counts)
        packed = datagram.packed_tick(header, packed_frames(frames), lines)
        try:
            if self._socket is not None:
                self._socket.send(packed)
                if datagram.may_be_urgent(packed):
                    self._end_recorders_wait()
            self.datagrams += 1
        except OSError as error:
            self._count_lost(len(frames))
            self._recording = False
            now_ns = time.monotonic_ns()
            self._checkpoint_ns = now_ns + _CHECKPOINT_AGAIN_NS
            if not isinstance(error, BlockingIOError) and error.errno != errno.EMSGSIZE:
                self._drop_socket()
                self._connect_ns = now_ns + _CONNECT_EVERY_NS
                fields = {"reason": error.strerror or str(error)}
                self._event_log.emit(Event("recorder_lost", Severity.INFO, fields))

    def _end_recorders_wait(self) -> None:
        """Have it take what has gathered: by a connection without a datagram."""
        with (
            contextlib.suppress(OSError),
            socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as connection,
        ):
            connection.setblocking(False)
            connection.connect(self._path)

    def _count_lost(self, frames: int) -> None:
        """A datagram that is not sent; the next one that is tells of it."""
        self.lost_datagrams += 1
        self.lost_frames += frames

    def _drop_socket(self) -> None:
        gone, self._socket, self._recording = self._socket, None, False
        if gone is not None:
            self._poll.unregister(gone)
            gone.close()

    def _look(self, now_ns: int) -> None:
        """Connect where a recorder listens; it is quiet where none does."""
        self._connect_ns = now_ns + _CONNECT_EVERY_NS
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            connection.setblocking(False)
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
            connection.connect(self._path)
            for part in datagram.packed_hello(self._hello().values()):
                connection.send(part)
        except OSError:
            connection.close()
            return
        self._socket = connection
        self._poll.register(connection, select.POLLOUT)
        self._event_log.emit(Event("recorder_connected", Severity.INFO, {"socket": self._path}))
        self._begin_segment(now_ns)

    def _hello(self) -> Hello:
        config = self._reloader.config
        if self._written is None or self._written[0] is not config:  # it takes a while to make
            digest, text = configuration.digest(config), configuration.yaml_text(config, DBC_FILE)
            self._written = config, digest, text
        _, digest, text = self._written
        return Hello(
            run=self._run,
            boot=self._boot,
            channel=config.bus.channel,
            clock=self._clock,
            settings=self._gateway.settings,
            config=text,
            config_digest=digest,
            dbc=self._dbc,
            dbc_digest=self._dbc_digest,
        )

    def _begin_segment(self, now_ns: int) -> None:
        """The next datagram begins with the state of now."""
        wall_ns = time.time_ns() - (time.monotonic_ns() - now_ns)
        self._stream.begin(now_ns, wall_ns)
        self._recording = True
        self._checkpoint_ns = now_ns + _CHECKPOINT_EVERY_NS

    def _note_event(self, event: Event) -> None:
        """Every event of the shell; those of a tick are in its result."""
        if self._recording and not any(event is one for one in self._gateway.tap.events):
            self._gateway.tap.note(ShellEvent(time.monotonic_ns(), event))
