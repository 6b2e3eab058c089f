"""Who hands a drive over: the socket they connect to, their credentials, who may, what was refused.

The socket is systemd's (LISTEN_FDS), or one of our own.
"""

import contextlib
import os
import pwd
import socket
import stat
import struct
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.errors import Problem, UnavailableError

_CREDENTIALS = struct.Struct("iII")
_SAY_EVERY_S = 10.0
_MOST_RUNS = 256
_FIRST_PASSED = 3


class TapListener:
    """Socket that gateways connect to; its name goes with it where it is our own."""

    def __init__(self, path: Path, environment: Mapping[str, str], own_pid: int) -> None:
        """Take the socket that was handed over, else make one; UnavailableError if neither can."""
        passed = environment.get("LISTEN_PID") == str(own_pid) and environment.get("LISTEN_FDS")
        self._own_path = None if passed else path
        self.name = "the socket of the service manager" if passed else str(path)
        self.sock = socket.socket(fileno=_FIRST_PASSED) if passed else _bound(path)
        self.sock.setblocking(False)

    def close(self) -> None:
        self.sock.close()
        if self._own_path is not None:
            with contextlib.suppress(OSError):
                self._own_path.unlink()


def _bound(path: Path) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        _remove_leftover(path)
        sock.bind(os.fspath(path))
        path.chmod(0o660)
        sock.listen(16)
    except OSError as error:
        sock.close()
        what = f"cannot listen at {path}: {error.strerror or error}"
        remedy = f"its folder must be there and be this user's; look at: ls -ld {path.parent}"
        raise UnavailableError(Problem(what, remedy=remedy)) from error
    return sock


def _remove_leftover(path: Path) -> None:
    if not os.path.lexists(path):
        return
    if not stat.S_ISSOCK(path.lstat().st_mode):
        what = f"{path} exists and is no socket"
        raise UnavailableError(Problem(what, remedy="remove it, or choose another path"))
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        try:
            probe.connect(os.fspath(path))
        except ConnectionRefusedError:
            path.unlink()
            return
    remedy = "stop it, or choose another path with --socket"
    raise UnavailableError(Problem(f"another recorder answers at {path}", remedy=remedy))


class Sender(NamedTuple):
    """Process at the other end, as the kernel saw it connect (SO_PEERCRED)."""

    pid: int
    uid: int
    gid: int

    def __str__(self) -> str:
        user = str(self.uid)
        with contextlib.suppress(KeyError):
            user = pwd.getpwuid(self.uid).pw_name
        return f"process {self.pid} of user {user}"


def sender_of(sock: socket.socket) -> Sender:
    """The process that connected; OSError where the kernel does not say."""
    found = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return Sender(*_CREDENTIALS.unpack(found))


def trusted_users(gateway_user: str | None) -> frozenset[int]:
    """Ids of those who may hand over: root, the recorder's own user, the gateway's.

    None: `vcu-gateway`, where that user exists. UnavailableError where a named one does not.
    """
    trusted = {0, os.geteuid()}
    try:
        trusted.add(pwd.getpwnam(gateway_user or "vcu-gateway").pw_uid)
    except KeyError as error:
        if gateway_user is not None:
            remedy = "name the user that the gateway runs as; look at: getent passwd"
            what = f"there is no user {gateway_user} (--gateway-user)"
            raise UnavailableError(Problem(what, remedy=remedy)) from error
    return frozenset(trusted)


class RunOwners:
    """Which process each run is of: the one that named it first, as long as that one lives."""

    def __init__(self) -> None:
        self._owners: dict[str, Sender] = {}

    def other(self, run: str, sender: Sender) -> Sender | None:
        """The process that has this run already; None where it is the sender's now."""
        owner = self._owners.get(run)
        if owner is not None and owner != sender and _lives(owner.pid):
            return owner
        while len(self._owners) >= _MOST_RUNS:
            del self._owners[self._least_wanted()]
        self._owners[run] = sender
        return None

    def _least_wanted(self) -> str:
        """A run whose process is gone, else the oldest of the process that named most.

        Whoever names many runs must not make another one's forgotten.
        """
        gone = (run for run, owner in self._owners.items() if not _lives(owner.pid))
        most = Counter(self._owners.values()).most_common(1)[0][0]
        of_most = (run for run, owner in self._owners.items() if owner == most)
        return next(gone, None) or next(of_most)


def _lives(pid: int) -> bool:
    """False where that process is gone, or is one that the kernel does not name."""
    if pid <= 0:
        return False
    try:
        os.kill(pid, 0)
    except OSError as error:
        return isinstance(error, PermissionError)
    return True


class Refusals:
    """Counts what was refused by its reason; a line in the log, of each at most one in 10 s.

    Attributes:
        counts: by reason, since the start.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self.counts: Counter[str] = Counter()
        self._say = say
        self._say_again_s: dict[str, float] = {}

    def note(self, reason: str, sentence: str) -> None:
        self.counts[reason] += 1
        now_s = time.monotonic()
        if now_s >= self._say_again_s.get(reason, now_s):
            self._say_again_s[reason] = now_s + _SAY_EVERY_S
            count = self.counts[reason]
            self._say(f"{sentence} (number {count} of this kind)" if count > 1 else sentence)
