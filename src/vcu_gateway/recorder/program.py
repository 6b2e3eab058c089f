"""Recorder's process: its parts, put together."""

import contextlib
import fcntl
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from types import FrameType

from vcu_gateway.errors import GatewayError, Problem, UnavailableError
from vcu_gateway.recorder.backlog import Backlog
from vcu_gateway.recorder.disk import Disk
from vcu_gateway.recorder.listener import TapListener
from vcu_gateway.recorder.options import RecorderOptions
from vcu_gateway.recorder.receiver import DatagramReceiver
from vcu_gateway.recorder.senders import Refusals, trusted_users
from vcu_gateway.recorder.status import StatusFile
from vcu_gateway.recorder.writer import Writer
from vcu_gateway.recording import layout

_STATUS_S = 1.0
_GATHER_S = 0.12
"""Between two looks, while nothing is urgent: three ticks cost little more than one, and what is
urgent waits no longer than this before it is written."""
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
        self._lock = _locked(options)
        self._backlog = Backlog(options.memory_bytes)
        self._disk = Disk(say)
        self._refusals = Refusals(say)
        try:
            self._writer = Writer(options, self._backlog, self._disk, say, self._refusals)
        except OSError as error:
            raise _cannot_use(options, error) from error
        self._status = StatusFile(options, self._writer, self._backlog, self._disk, self._refusals)

    def run(self) -> None:
        """Record until a signal; UnavailableError, and GatewayError after a bug of the writer."""
        with _woken_by_signals(self._on_signal) as wake_up:
            # After the signals: whoever finds the socket may stop the recorder, in order.
            listener = TapListener(self._options.socket_path, os.environ, os.getpid())
            receiver = DatagramReceiver(
                listener,
                wake_up,
                self._backlog,
                self._writer.wake,
                self._trusted,
                self._refusals,
            )
            self._writer.start()
            self._say(f"recording into {self._options.folder}, from {listener.name}")
            try:
                self._receive(receiver)
                receiver.receive_rest(_LAST_DATAGRAMS_S)
            finally:
                listener.close()
                receiver.close()
                in_order = self._writer.stop(_LAST_WRITES_S)
        self._status.write(())
        if not in_order:
            self._say("the disk does not take the last seconds: they are lost")

    def _receive(self, receiver: DatagramReceiver) -> None:
        status_s = 0.0
        while not self._stop:
            now_s = time.monotonic()
            if now_s >= status_s:
                status_s = now_s + _STATUS_S
                self._disk.watch()
                self._status.write(receiver.connections)
                if not self._writer.is_alive:
                    raise GatewayError(Problem("the writer's thread has ended by a bug"))
            is_calm = now_s - receiver.urgent_s > _CALM_S
            # A gateway that wakes nobody hands its datagrams over sooner.
            if is_calm and receiver.connections:
                receiver.look()
            else:
                receiver.receive(max(0.0, status_s - now_s))
            if is_calm:
                time.sleep(_GATHER_S)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        del frame
        if number == signal.SIGUSR1:
            self._writer.request_incident()
        else:
            self._stop = True


@contextlib.contextmanager
def _woken_by_signals(
    handler: Callable[[int, FrameType | None], None],
) -> Iterator[socket.socket]:
    awake, wake_up = socket.socketpair()
    for sock in (awake, wake_up):
        sock.setblocking(False)
    numbers = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR1)
    before = {number: signal.signal(number, handler) for number in numbers}
    signal.set_wakeup_fd(awake.fileno(), warn_on_full_buffer=False)
    try:
        yield wake_up
    finally:
        signal.set_wakeup_fd(-1)
        for number, old in before.items():
            signal.signal(number, old)
        awake.close()
        wake_up.close()


def _locked(options: RecorderOptions) -> int:
    """Descriptor of the folder, which is ours alone; made where it is not there."""
    folder = options.folder
    try:
        for path in (folder, folder / layout.DRIVES, folder / layout.INCIDENTS):
            path.mkdir(mode=0o750, parents=True, exist_ok=True)
            layout.remove_partial_folders(path)
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise _cannot_use(options, error) from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        what = f"another recorder writes into {folder}"
        raise UnavailableError(Problem(what, remedy="give each a folder with --folder")) from error
    return descriptor


def _cannot_use(options: RecorderOptions, error: OSError) -> UnavailableError:
    what = f"cannot record into {options.folder}: {error.strerror or error}"
    remedy = f"it must be a folder that this user can write; look at: ls -ld {options.folder}"
    return UnavailableError(Problem(what, remedy=remedy))
