"""Bus connection: opens, receives, sends and closes, whatever the interface.

Received frames go to one callable, on the thread that calls `read_waiting`: the ticking one. A
failed interface is reported once through `on_lost`; the reconnector opens it again, the ticking
thread starts sending again.
"""

import contextlib
import dataclasses
import errno
import os
import pwd
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from vcu_gateway.bus.interface import unopened
from vcu_gateway.bus.reader import Bus, FrameListener, open_bus
from vcu_gateway.bus.settings import BusCounters, BusSettings
from vcu_gateway.core import j1939
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.python_can import can

_SERVICE_ACCOUNT = "vcu-gateway"
_WAITING = 128
# A gateway that starts at the same moment has the name some microseconds before it listens.
_TRIES = 5
_PAUSE_S = 0.02
_credentials = struct.Struct("3i")


class InstanceLock:
    """Lock of one interface of this machine for this process, until `release` or its end.

    It is the name of a Unix socket in the abstract namespace, which belongs to the network
    namespace that the interface is in, and needs no file.

    Any process can take such a name, so it counts only when it is held by a user who could start a
    gateway: root, our own user or the service's. Another holder, or one that does not answer, is
    reported and ignored: no process without privilege can keep the gateway from starting. A real
    gateway that does not answer (any process can fill its queue) is seen all the same: the second
    one listens before it talks, and stays silent.

    Attributes:
        passed_by: the holder without a right to it, as words; None where this process has it.
    """

    def __init__(self, channel: str) -> None:
        """Take it; UnavailableError where another gateway has it."""
        self._name = b"\0vcu-gateway/" + os.fsencode(channel)
        self.passed_by: str | None = None
        for _ in range(_TRIES):
            if self._taken():
                self.passed_by = None
                return
            try:
                pid, uid = _holder(self._name)
            except OSError as error:
                self.passed_by = f"a process that does not answer: {error.strerror}"
                time.sleep(_PAUSE_S)
                continue
            if uid in _trusted():
                raise UnavailableError(_refusal(channel, pid))
            self.passed_by = f"process {pid} of user {uid}"
            return

    def _taken(self) -> bool:
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.bind(self._name)
            self._socket.listen(_WAITING)  # only so that others can read our credentials
            self._socket.setblocking(False)
        except OSError:
            self._socket.close()
            return False
        return True

    @property
    def descriptor(self) -> int | None:
        """Readable while a process queries the holder; None where this process has no lock."""
        return None if self.passed_by is not None else self._socket.fileno()

    def answer(self) -> None:
        """Accept and close the connections of processes that query the holder; never waits."""
        with contextlib.suppress(OSError):
            for _ in range(_WAITING):
                self._socket.accept()[0].close()

    def release(self) -> None:
        self._socket.close()


def _trusted() -> set[int]:
    """Users whose processes may be a gateway on this machine."""
    users = {0, os.geteuid()}
    with contextlib.suppress(KeyError):
        users.add(pwd.getpwnam(_SERVICE_ACCOUNT).pw_uid)
    return users


def _refusal(channel: str, pid: int) -> Problem:
    who = f"another gateway, process {pid}," if pid else "another gateway"
    what = f"{who} commands on {channel} already; a second one would fight it"
    return Problem(what, remedy="stop that one first, or set bus.channel to another interface")


def _holder(name: bytes) -> tuple[int, int]:
    """Process (0 where it is not visible from here) and user of the listening process.

    Raises OSError where none listens, or where its queue is full.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as peer:
        peer.setblocking(False)
        peer.connect(name)
        credentials = peer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _credentials.size)
    pid, uid, _ = _credentials.unpack(credentials)
    return pid, uid


__all__ = ["BusConnection", "BusCounters", "BusSettings", "kernel_filters"]

# The interface is down or gone, whatever the next attempt would give.
_GONE = {"ENETDOWN", "ENODEV", "ENXIO"}


class BusConnection:
    """Connection to one bus, open or lost.

    Opening, closing and their waiting belong to one thread at a time; `read_waiting`, `send` and
    `start_sending` to the ticking thread; `mark_lost` may come from any.

    Attributes:
        lost: why the interface cannot be used, as a sentence; None while it is open.
        on_lost: called on the thread that noticed, once for each opening.
        instance_lock: None before `acquire_lock` and after `release_lock`, and on other buses.
    """

    def __init__(
        self,
        settings: BusSettings,
        identifiers: Iterable[int],
        receive: Callable[[Frame], None],
        groups: Iterable[int] = (),
    ) -> None:
        self.settings = settings
        self._filters = kernel_filters(identifiers, groups) if settings.kernel_filters else None
        self._receive = receive
        self._bus: Bus | None = None
        self._sending_bus: Bus | None = None
        self._send_lock = threading.Lock()
        self._read_since_loss = threading.Event()
        self.instance_lock: InstanceLock | None = None
        self.counters = BusCounters()
        self.lost: str | None = "not opened yet"
        self.on_lost: Callable[[], None] = lambda: None

    @property
    def is_open(self) -> bool:
        """True while nothing has failed since the last opening."""
        return self.lost is None

    @property
    def dropped(self) -> int | None:
        """Frames that arrived and were never read; None where that cannot be known."""
        return self.counters.dropped if self.settings.interface == "socketcan" else None

    @property
    def receive_buffer_bytes(self) -> int | None:
        """Receive buffer that the kernel granted; None where the bus has none."""
        return None if self._bus is None else self._bus.receive_buffer_bytes

    @property
    def drains(self) -> int | None:
        """Times that the open bus was read to the end; None where that is not our part."""
        bus = self._bus
        return bus.drains if bus is not None and self.is_open else None

    def report(self) -> dict[str, Any]:
        return {**dataclasses.asdict(self.counters), "dropped": self.dropped, "lost": self.lost}

    def acquire_lock(self) -> None:
        """Become the only gateway on this interface of the machine, until `release_lock`.

        Raises UnavailableError where another gateway is.
        """
        if self.instance_lock is None and self.settings.interface == "socketcan":
            self.instance_lock = InstanceLock(self.settings.channel)

    def release_lock(self) -> None:
        lock, self.instance_lock = self.instance_lock, None
        if lock is not None:
            lock.release()

    def open(self) -> None:
        """Open the bus and start receiving; nothing is sent before `start_sending`.

        Raises UnavailableError, with what to do, where the interface is not there.
        """
        self.close()
        try:
            bus = open_bus(self.settings, self._filters, self.counters)
        except (OSError, can.CanError, ImportError) as error:
            raise UnavailableError(unopened(error, self.settings)) from error
        self.lost = None
        bus.start(self._listener(bus))
        self._bus = bus

    def _listener(self, bus: Bus) -> FrameListener:
        def lost(why: str) -> None:
            if self._bus is None or self._bus is bus:
                self.mark_lost(why)  # the reader of an earlier opening does not count

        return FrameListener(self._receive, self.counters, lost, bus.stamps_are_monotonic)

    def read_waiting(self, until_ns: int) -> int:
        """Take in what arrived until this time; how many frames that were.

        On the ticking thread, right before a tick. What came before the interface was lost is taken
        in, too. It neither waits nor raises.
        """
        was_lost = self.lost is not None
        bus = self._bus
        frames = 0 if bus is None else bus.read_waiting(until_ns)
        if was_lost:
            self._read_since_loss.set()
        return frames

    def wait_until_read(self, patience_s: float) -> None:
        """Wait until what came before the loss has been read, before closing."""
        self._read_since_loss.wait(patience_s)

    def start_sending(self) -> None:
        self._sending_bus = self._bus if self.is_open else None

    def mark_lost(self, why: str) -> None:
        """Record that the interface cannot be used: nothing is sent on it again."""
        if self.lost is None:
            self._read_since_loss.clear()
            self.lost = why
            self.on_lost()

    def send(self, frame: OutFrame) -> bool:
        """Send now or not at all; False, and counted, where the interface did not take it.

        It never waits, not for another thread either: a connection that is being closed is closed.
        """
        if self.lost is not None or not self._send_lock.acquire(blocking=False):
            return self.count_unsent("closed")
        try:
            bus = self._sending_bus
            if bus is None:
                return self.count_unsent("closed")
            bus.send_now(frame.can_id, frame.data)
        except (OSError, can.CanError) as error:
            return self._not_sent(error)
        finally:
            self._send_lock.release()
        self.counters.sent += 1
        return True

    def _not_sent(self, error: Exception) -> bool:
        name = _errno_name(error)
        if name in _GONE:
            # The kernel reports it once, to the first caller: the reader may never see it.
            self.mark_lost(f"Failed to send: {error}")
        return self.count_unsent(name)

    def count_unsent(self, why: str) -> bool:
        """Count a frame that is not sent, by its reason; False."""
        refused = self.counters.refused
        refused[why] = refused.get(why, 0) + 1
        return False

    def close(self, why: str = "closed") -> None:
        """Stop receiving, then close; nothing happens where it is closed already."""
        self.lost = self.lost or why
        with self._send_lock:
            self._sending_bus = None
        bus, self._bus = self._bus, None
        if bus is not None:
            bus.close()


def kernel_filters(identifiers: Iterable[int], groups: Iterable[int] = ()) -> list[Any]:
    """Filters for exactly these messages, at any priority, extended frames only.

    `groups` are `j1939.group_key`s that pass whoever sent them.
    """
    whole = set(groups)
    keys = {j1939.match_key(can_id) for can_id in identifiers}
    keys = {key for key in keys if j1939.group_key(key) not in whole}
    masked = [(key, j1939.MATCH_MASK) for key in keys] + [(key, j1939.GROUP_MASK) for key in whole]
    return [{"can_id": key, "can_mask": mask, "extended": True} for key, mask in sorted(masked)]


def _errno_name(error: Exception) -> str:
    """ENOBUFS and so on; python-can reports a full queue without a number.

    EAGAIN is a full queue too: our own share of it.
    """
    code: int = getattr(error, "errno", None) or getattr(error, "error_code", None) or errno.ENOBUFS
    return errno.errorcode.get(errno.ENOBUFS if code == errno.EAGAIN else code, str(code))
