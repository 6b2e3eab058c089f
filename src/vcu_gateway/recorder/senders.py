"""Who hands a drive over: the credentials of a connection, who may, and what was refused."""

import os
import pwd
import socket
import struct
import time
from collections import Counter
from collections.abc import Callable
from typing import NamedTuple

from vcu_gateway.errors import Problem, UnavailableError

GATEWAY_USER = "vcu-gateway"
_CREDENTIALS = struct.Struct("iII")
_SAY_EVERY_S = 10.0
_MOST_RUNS = 256


class Sender(NamedTuple):
    """Process at the other end, as the kernel saw it connect (SO_PEERCRED)."""

    pid: int
    uid: int
    gid: int

    def __str__(self) -> str:
        return f"process {self.pid} of user {_user(self.uid)}"


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
        trusted.add(pwd.getpwnam(gateway_user or GATEWAY_USER).pw_uid)
    except KeyError as error:
        if gateway_user is not None:
            remedy = "name the user that the gateway runs as; look at: getent passwd"
            what = f"there is no user {gateway_user} (--gateway-user)"
            raise UnavailableError(Problem(what, remedy=remedy)) from error
    return frozenset(trusted)


def _user(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


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
            del self._owners[next(iter(self._owners))]
        self._owners[run] = sender
        return None


def _lives(pid: int) -> bool:
    """False where that process is gone, or is one that the kernel does not name."""
    if pid <= 0:
        return False
    try:
        os.kill(pid, 0)
    except PermissionError:
        return True
    except OSError:
        return False
    return True


class Allowance:
    """Token bucket: bursts of `burst`, and `a_second` in the long run."""

    def __init__(self, burst: float, a_second: float) -> None:
        self._burst, self._a_second = burst, a_second
        self._left, self._at_s = burst, time.monotonic()

    def take(self) -> bool:
        now_s = time.monotonic()
        self._left = min(self._burst, self._left + (now_s - self._at_s) * self._a_second)
        self._at_s = now_s
        if self._left < 1:
            return False
        self._left -= 1
        return True


class Refusals:
    """Counts what was refused by its reason; a line in the log, of each at most one in 10 s.

    Attributes:
        counts: by reason, since the start.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self.counts: Counter[str] = Counter()
        self._say = say
        self._said_s: dict[str, float] = {}

    def note(self, reason: str, sentence: str) -> None:
        self.counts[reason] += 1
        now_s = time.monotonic()
        said_s = self._said_s.get(reason)
        if said_s is None or now_s - said_s >= _SAY_EVERY_S:
            self._said_s[reason] = now_s
            count = self.counts[reason]
            self._say(f"{sentence} (number {count} of this kind)" if count > 1 else sentence)
