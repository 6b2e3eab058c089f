"""Instance lock: one gateway on an interface of this machine.

The lock is the name of a Unix socket in the abstract namespace: it belongs to the network
namespace that the interface is in, needs no file, and is free again when the process has ended,
however it ended.

Any process can take such a name, so it counts only when it is held by a user who could start a
gateway: root, our own user or the service's. Another holder, or one that does not answer, is
reported and ignored: no process without privilege can keep the gateway from starting. A real
gateway that does not answer (any process can fill its queue) is seen all the same: the second one
listens before it talks, and stays silent.
"""

import contextlib
import os
import pwd
import socket
import struct
import time

from vcu_gateway.errors import Problem, UnavailableError

_SERVICE_ACCOUNT = "vcu-gateway"
_WAITING = 128
# A gateway that starts at the same moment has the name some microseconds before it listens.
_TRIES = 5
_PAUSE_S = 0.02
_credentials = struct.Struct("3i")


class InstanceLock:
    """Lock of one interface for this process, until `release` or its end.

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
