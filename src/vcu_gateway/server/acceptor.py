"""Acceptor: a bounded rate and number of connections, some reserved for operators."""

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
from vcu_gateway.server.rate_limit import TokenBucket
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
    """Accepts the connections of one listening socket."""

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
        self._rate = TokenBucket(limits.accepts_per_s, limits.clients, now_ns)
        self._pause_until_ns = now_ns

    @property
    def ready_ns(self) -> int:
        """Time from which it accepts; until then connections wait in the backlog."""
        return max(self._pause_until_ns, self._rate.ready_ns)

    def accept(self, counts: ConnectionCounts, evict_one: EvictOne, now_ns: int) -> Session | None:
        """Session of the next connection; None where none waits, or it was turned away."""
        try:
            sock, _ = self.sock.accept()
        except BlockingIOError:
            return None
        except OSError as error:
            if error.errno in _OUT_OF_RESOURCES:
                self._pause_until_ns = now_ns + self._limits.accept_pause_ns
                return None
            if error.errno in _ABORTED:
                return None
            raise
        self._rate.take(now_ns)
        sock.setblocking(False)
        caller = self._caller(sock)
        if not self._has_place(caller, counts, evict_one):
            self._turn_away(sock)
            return None
        self._counters.accepted += 1
        return Session(sock, caller, self._limits, now_ns)

    def _caller(self, sock: socket.socket) -> Caller:
        peer = peer_of(sock)
        return Caller(next(self._numbers), peer, self._policy.rights_of(peer))

    def _has_place(self, caller: Caller, counts: ConnectionCounts, evict_one: EvictOne) -> bool:
        """True where a place is free, or was made."""
        limits = self._limits
        if may_only_read(caller) and counts.readers >= limits.clients - limits.reserved_clients:
            return evict_one(caller, True)
        return counts.clients < limits.clients or evict_one(caller, False)

    def _turn_away(self, sock: socket.socket) -> None:
        self._counters.turned_away += 1
        what = (
            f"no place is left: {self._limits.clients} clients at most,"
            f" {self._limits.reserved_clients} places kept for those who may operate,"
            " and a demand keeps its place"
        )
        line = jsonrpc.error_line(None, RequestError(ErrorCode.TOO_MANY_CLIENTS, what))
        with contextlib.suppress(OSError):  # the peer may have closed it
            sock.send(line, socket.MSG_NOSIGNAL)
        sock.close()


def may_only_read(caller: Caller) -> bool:
    """True where none of the reserved places is for this peer."""
    return caller.rights == {Right.READ}
