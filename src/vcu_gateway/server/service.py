"""What the parts of the server share: settings, service, counters and the queue of replies."""

import os
import weakref
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from vcu_gateway.api.errors import Peer, Policy, RequestError, Right
from vcu_gateway.api.methods import Params
from vcu_gateway.api.results import ApiCounts, State
from vcu_gateway.server.views import result_of
from vcu_gateway.units import NS_PER_S


class SessionLimits(NamedTuple):
    """Limits on the cost of the clients.

    Attributes:
        reserved_clients: of `clients`, for peers that may do more than read.
        rate_per_s: requests of one connection; `burst` of them at once.
        pending_requests: requests of one connection that wait for their reply.
        output_bytes: replies that one connection has not read.
        timeout_ns: for the end of a line, and for a reader to go on reading.
        accept_pause_ns: without accepting, after the system had no descriptor or memory left.
        linger_ns: for pending replies at the end of the server.
    """

    clients: int = 16
    reserved_clients: int = 4
    rate_per_s: int = 200
    burst: int = 50
    pending_requests: int = 16
    output_bytes: int = 262_144
    timeout_ns: int = 10 * NS_PER_S
    accept_pause_ns: int = NS_PER_S
    linger_ns: int = 300_000_000


class ServerSettings(NamedTuple):
    """Address of the API, the rights of its peers, and the limits on what they cost.

    Attributes:
        owner: user number of the socket; None leaves it as it is. group: the same, of its group.
        mode: permission bits of the socket.
    """

    socket_path: Path
    policy: Policy
    owner: int | None = None
    group: int | None = None
    mode: int = 0o660
    limits: SessionLimits = SessionLimits()


Reply = Mapping[str, Any] | RequestError
"""A result, or the error that is answered instead."""


class Caller(NamedTuple):
    """Peer of one connection, with its rights.

    Attributes:
        connection: number of the connection, never used twice.
    """

    connection: int
    peer: Peer
    rights: frozenset[Right]


class RequestService(Protocol):
    """Request handlers; every method is called on the API's thread and returns at once."""

    def handle(
        self, method: str, params: Params, caller: Caller, reply: Callable[[Reply], None]
    ) -> None:
        """Handle a permitted request and call `reply` once, now or later, from any thread."""

    def state(self, messages: list[str] | None) -> State:
        """State for an update of a subscription; RequestError where a message is not known."""

    def owns_demand(self, caller: Caller) -> bool:
        """True while a fresh demand of this connection counts."""

    def log_refused(self, method: str, caller: Caller, sentence: str) -> None:
        """Log a request that was refused for want of a right."""

    def log_closed(self, caller: Caller, reason: str) -> None:
        """Log a connection that the gateway closed."""

    def end_demands(self, caller: Caller) -> None:
        """End the demands of a connection that has ended, whoever ended it."""


@dataclass(slots=True)
class Counters:
    """Counters written by the API's thread alone: the fields of results.ApiCounts."""

    clients: int = 0
    accepted: int = 0
    turned_away: int = 0
    requests: int = 0
    errors: Counter[str] = field(default_factory=Counter)
    closed: Counter[str] = field(default_factory=Counter)
    lost_updates: int = 0
    gave_way: int = 0
    stopped_anyway: int = 0

    def report(self) -> ApiCounts:
        """Copy of the counters; from any thread."""
        return result_of(ApiCounts, self, errors=self.errors.copy(), closed=self.closed.copy())


class QueuedReply(NamedTuple):
    """Reply to the request `number` of the connection `connection`."""

    connection: int
    number: int
    reply: Reply


class ReplyQueue:
    """Queue with a descriptor that becomes readable; `put` costs one system call at most.

    The ticking thread puts replies in, so there is no lock that it could wait for.

    Attributes:
        queued: the oldest first; the API's thread takes them out.
    """

    def __init__(self) -> None:
        self.queued: deque[QueuedReply] = deque()
        self._is_woken = False
        self._is_closed = False
        self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        # Closed only when no producer is left: its number may belong to the bus by then.
        weakref.finalize(self, os.close, self.fd)

    def put(self, connection: int, number: int, reply: Reply) -> None:
        """Append a reply and wake the API's thread; from any thread, at any time."""
        if not self._is_closed:
            self.queued.append(QueuedReply(connection, number, reply))
            self.wake()

    def wake(self) -> None:
        if not self._is_woken:
            self._is_woken = True
            os.eventfd_write(self.fd, 1)

    def clear_wakeup(self) -> None:
        """Reset the descriptor, before taking them: a reply put later makes it readable again."""
        os.eventfd_read(self.fd)
        self._is_woken = False

    def close(self) -> None:
        """Drop the queued replies and all that are put later."""
        self._is_closed = True
        self.queued.clear()
