"""Who is let in: so many a second, so many at once, some places for those who may do more."""

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
from vcu_gateway.server.session import Limits, Session
from vcu_gateway.server.sockets import peer_of

_NOTHING_LEFT = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
_GIVEN_UP = (errno.ECONNABORTED, errno.EPROTO, errno.EINTR)


class ConnectionCounts(NamedTuple):
    """Who is in now: `readers` may only read."""

    clients: int
    readers: int
    metrics_clients: int


EvictOne = Callable[[Caller, bool], bool]
"""Called where no place is left for this caller; True where one was made.

The second argument is True where only the place of one who may only read will do.
"""


class Acceptor:
    """One listening socket.

    Attributes:
        is_for_metrics: its connections are HTTP alone.
        ready_ns: from when on it accepts again.
    """

    _numbers = itertools.count(1)

    def __init__(
        self,
        sock: socket.socket,
        is_for_metrics: bool,
        policy: Policy,
        limits: Limits,
        counters: Counters,
        now_ns: int,
    ) -> None:
        self.sock = sock
        self.is_for_metrics = is_for_metrics
        self._policy = policy
        self._limits = limits
        self._counters = counters
        self._pace = TokenBucket(limits.accepts_per_s, limits.clients, now_ns)
        self._pause_until_ns = now_ns

    @property
    def ready_ns(self) -> int:
        """From when on it accepts; until then, who connects waits in the backlog."""
        return max(self._pause_until_ns, self._pace.ready_ns)

    def accept(self, guests: ConnectionCounts, make_room: EvictOne, now_ns: int) -> Session | None:
        """The next connection; None where none waits, or it was turned away."""
        try:
            sock, _ = self.sock.accept()
        except BlockingIOError:
            return None
        except OSError as error:
            if error.errno in _NOTHING_LEFT:
                self._pause_until_ns = now_ns + self._limits.pause_ns
                return None
            if error.errno in _GIVEN_UP:
                return None
            raise
        self._pace.take(now_ns)
        sock.setblocking(False)
        caller = None if self.is_for_metrics else self._caller(sock)
        if not self._has_place(caller, guests, make_room):
            self._turn_away(sock)
            return None
        self._counters.accepted += 1
        return Session(sock, caller, self._limits, now_ns)

    def _caller(self, sock: socket.socket) -> Caller:
        peer = peer_of(sock)
        return Caller(next(self._numbers), peer, self._policy.rights_of(peer))

    def _has_place(
        self, caller: Caller | None, guests: ConnectionCounts, make_room: EvictOne
    ) -> bool:
        """True where a place is left, or was made."""
        limits = self._limits
        if caller is None:
            return guests.metrics_clients < limits.metrics_clients
        if may_only_read(caller) and guests.readers >= limits.clients - limits.kept_places:
            return make_room(caller, True)
        return guests.clients < limits.clients or make_room(caller, False)

    def _turn_away(self, sock: socket.socket) -> None:
        self._counters.turned_away += 1
        if not self.is_for_metrics:
            what = (
                f"no place is left: {self._limits.clients} clients at most,"
                f" {self._limits.kept_places} places kept for those who may operate,"
                " and a demand keeps its place"
            )
            line = jsonrpc.error_line(None, RequestError(ErrorCode.TOO_MANY_CLIENTS, what))
            with contextlib.suppress(OSError):  # it may have left already
                sock.send(line, socket.MSG_NOSIGNAL)
        sock.close()


def may_only_read(caller: Caller) -> bool:
    """True where none of the kept places is for this peer."""
    return caller.rights == {Right.READ}
