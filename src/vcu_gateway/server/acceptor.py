"""Acceptor: a bounded number of connections, some reserved for operators."""

import contextlib
import errno
import itertools
import socket
from collections.abc import Callable
from typing import NamedTuple

from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.api.rights import Policy, Right
from vcu_gateway.server import jsonrpc
from vcu_gateway.server.counters import Counters
from vcu_gateway.server.service import Caller
from vcu_gateway.server.session import Session
from vcu_gateway.server.settings import SessionLimits
from vcu_gateway.server.sockets import peer_of

_OUT_OF_RESOURCES = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
_ABORTED = (errno.ECONNABORTED, errno.EPROTO, errno.EINTR)


class ConnectionCounts(NamedTuple):
    """Connections that are open; `readers` of them may only read."""

    clients: int
    readers: int


EvictOne = Callable[[Caller, bool], bool]
"""Closes a connection to make room for this caller; True where one was closed.

The second argument is True where it has to be one that may only read.
"""


class Acceptor:
    """Accepts the connections of one listening socket.

    Attributes:
        ready_ns: time from which it accepts; until then connections wait in the backlog.
    """

    _numbers = itertools.count(1)

    def __init__(
        self,
        sock: socket.socket,
        policy: Policy,
        limits: SessionLimits,
        counters: Counters,
        now_ns: int,
    ) -> None:
        self.sock = sock
        self._policy = policy
        self._limits = limits
        self._counters = counters
        self.ready_ns = now_ns

    def next_socket(self, now_ns: int) -> socket.socket | None:
        """Socket of the next connection; None where none waits, or none can be had now."""
        try:
            sock, _ = self.sock.accept()
        except BlockingIOError:
            return None
        except OSError as error:
            if error.errno in _OUT_OF_RESOURCES:
                self.ready_ns = now_ns + self._limits.accept_pause_ns
                return None
            if error.errno in _ABORTED:
                return None
            raise
        sock.setblocking(False)
        return sock

    def session(self, sock: socket.socket, now_ns: int) -> Session:
        peer = peer_of(sock)
        caller = Caller(next(self._numbers), peer, self._policy.rights_of(peer))
        return Session(sock, caller, self._limits, now_ns)

    def has_place(self, caller: Caller, counts: ConnectionCounts, evict_one: EvictOne) -> bool:
        """True where a place is free, or was made."""
        limits = self._limits
        if may_only_read(caller) and counts.readers >= limits.clients - limits.reserved_clients:
            return evict_one(caller, True)
        return counts.clients < limits.clients or evict_one(caller, False)

    def turn_away(self, sock: socket.socket) -> None:
        self._counters.turned_away += 1
        what = (
            f"no place is left: {self._limits.clients} clients at most,"
            f" {self._limits.reserved_clients} places kept for those who may operate,"
            " and a demand keeps its place"
        )
        line = jsonrpc.error_line(None, RequestError(ErrorCode.TOO_MANY_CLIENTS, what))
        with contextlib.suppress(OSError):  # the peer may have closed it
            sock.send(line, socket.MSG_NOSIGNAL)


def has_left(sock: socket.socket) -> bool:
    """True where the peer has ended and asked for nothing: the cheapest of a flood."""
    try:
        return not sock.recv(1, socket.MSG_PEEK)
    except BlockingIOError:
        return False
    except OSError:
        return True


def may_only_read(caller: Caller) -> bool:
    """True where none of the reserved places is for this peer."""
    return caller.rights == {Right.READ}
