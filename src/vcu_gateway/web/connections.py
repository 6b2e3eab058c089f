"""Connections with limits that uvicorn has not: on their number, and on a slow beginning.

A new connection always finds a place: whoever wants to stop the vehicle gets in. Where all are
taken, or all of its address, another one gives way: first those that no session was seen on, then
those with one, then streams, of each the longest idle. One on which a stop is asked for stays.
Where an address makes others give way again and again its connections are parked: a stop and
signing in are carried out there, everything else waits for a place. What is more than may be parked
is closed unread, a second later: so whoever connects again at once does that once a second.

Token buckets by key: of questions, of connections that give way, of attempts to sign in.
"""

import asyncio
import contextlib
import fcntl
import socket
import sys
import termios
import time
from collections import Counter, OrderedDict, deque
from collections.abc import Collection, Iterator
from typing import Any, ClassVar

import h11
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from vcu_gateway.units import NS_PER_S

_KEYS = 1024
_ATTEMPTS_OF_ADDRESS, _ATTEMPTS_OF_NAME = 5, 20
_ATTEMPT_S = 30.0


class CostLimit:
    """Token bucket for each key: `burst` tokens at once, then `per_s`; who comes too early waits.

    The keys that were used last are kept, 1024 of them.
    """

    def __init__(self, burst: int, per_s: float) -> None:
        self._token_ns = int(NS_PER_S / per_s)
        self._burst_ns = burst * self._token_ns
        self._free_ns: OrderedDict[str, int] = OrderedDict()

    def wait_ns(self, key: str, cost: int, now_ns: int) -> int:
        """Time until so much may be taken; 0 is now."""
        debt_ns = max(0, self._free_ns.get(key, 0) - now_ns)
        return max(0, debt_ns + cost * self._token_ns - self._burst_ns)

    def take(self, key: str, cost: int, now_ns: int) -> None:
        """Take it, from now or from after the wait."""
        self._free_ns[key] = max(self._free_ns.get(key, 0), now_ns) + cost * self._token_ns
        self._free_ns.move_to_end(key)
        if len(self._free_ns) > _KEYS:
            self._free_ns.popitem(last=False)

    def forgive(self, key: str) -> None:
        """Give this key all of its tokens back."""
        self._free_ns.pop(key, None)


@contextlib.contextmanager
def counted(counts: Counter[str], key: str) -> Iterator[None]:
    """This key counts for as long as the block; one that nobody has is not kept."""
    counts[key] += 1
    try:
        yield
    finally:
        counts[key] -= 1
        if not counts[key]:
            del counts[key]


class LoginLimit:
    """Limits on failed attempts: 5 of an address, 20 of a name, then one every 30 s.

    A name has more, so that a stranger cannot keep somebody out who is at another address soon.
    """

    def __init__(self) -> None:
        self._addresses = CostLimit(_ATTEMPTS_OF_ADDRESS, 1 / _ATTEMPT_S)
        self._names = CostLimit(_ATTEMPTS_OF_NAME, 1 / _ATTEMPT_S)

    def wait_s(self, address: str, name: str, now_ns: int) -> int:
        """Seconds until an attempt is allowed, rounded up; 0 is now."""
        of_address = self._addresses.wait_ns(address, 1, now_ns)
        return -(-max(of_address, self._names.wait_ns(name, 1, now_ns)) // NS_PER_S)

    def failed(self, address: str, name: str, now_ns: int) -> None:
        self._addresses.take(address, 1, now_ns)
        self._names.take(name, 1, now_ns)

    def succeeded(self, address: str) -> None:
        self._addresses.forgive(address)


MOST_CONNECTIONS = 256
MOST_PER_ADDRESS = 64
MOST_PARKED = 128
MOST_PARKED_PER_ADDRESS = 64
MOST_REFUSED = 512
REQUEST_WITHIN_S = 10.0

_EVICTIONS_AT_ONCE, _EVICTIONS_PER_S = 8, 20
_CLOSED_AT_ONCE = 32
_REFUSED_S = 1.0
_PARKED_S = 1 / _EVICTIONS_PER_S

STOPS = frozenset({"/api/actions/estop", "/api/actions/disarm"})
SESSION = "/api/session"
STREAM = "/api/stream"

_PLACE, _TRANSPORT = "vcu_gateway.place", "vcu_gateway.transport"


class Place:
    """Place of one connection: what decides whether it gives way.

    Attributes:
        has_session: somebody who is signed in has asked on it.
        path: of the request that is in work; empty where none is.
        active_s: monotonic time at which it came, or a request of it began or ended.
        is_parked: it has none yet; all but a stop and signing in waits for it.
    """

    def __init__(self, address: str, now_s: float) -> None:
        self.address = address
        self.has_session = self.is_parked = False
        self._is_taken = asyncio.Event()
        self.path = ""
        self.active_s = now_s

    def unpark(self) -> None:
        """It has a place from now on."""
        self.is_parked, self.active_s = False, time.monotonic()
        self._is_taken.set()

    async def wait_for(self, path: str) -> None:
        """Wait for the place, unless this is the path of a stop or of signing in."""
        if self.is_parked and path not in STOPS and path != SESSION:
            await self._is_taken.wait()

    @property
    def rank(self) -> tuple[bool, bool, float]:
        """The least one gives way."""
        return self.has_session, self.path == STREAM, self.active_s

    @contextlib.contextmanager
    def asked(self, path: str) -> Iterator[None]:
        """A request is in work for as long as the block."""
        self.path, self.active_s = path, time.monotonic()
        try:
            yield
        finally:
            self.path, self.active_s = "", time.monotonic()


def gives_way(places: Collection[Place], address: str) -> Place | None:
    """Place that a new connection of this address takes; None where it needs none of them."""
    own = [place for place in places if place.address == address]
    if len(own) < MOST_PER_ADDRESS and len(places) < MOST_CONNECTIONS:
        return None
    candidates = own if len(own) >= MOST_PER_ADDRESS else places
    idle = [place for place in candidates if place.path not in STOPS]
    return min(idle, key=lambda place: place.rank, default=None)


def has_session(scope: Scope) -> None:
    """Note that somebody who is signed in asks on this connection."""
    place = (scope.get("extensions") or {}).get(_PLACE)
    if place is not None:
        place.has_session = True


def undelivered_bytes(scope: Scope) -> int:
    """What the other end has not acknowledged: what waits in the kernel grows old there.

    Without end where the connection ends.
    """
    transport: asyncio.Transport = scope["extensions"][_TRANSPORT]
    if transport.is_closing():
        return sys.maxsize
    connection = transport.get_extra_info("socket")
    queued = fcntl.ioctl(connection.fileno(), termios.TIOCOUTQ, bytes(4))
    return transport.get_write_buffer_size() + int.from_bytes(queued, sys.byteorder)


class LimitedListener(socket.socket):
    """Listening socket that ends or parks connections where there are too many.

    It counts what it accepted, whether TLS has begun on it or not.
    """

    def __init__(self, family: socket.AddressFamily) -> None:
        super().__init__(family, socket.SOCK_STREAM)
        self._open: dict[Place, socket.socket] = {}
        self._parked: dict[Place, socket.socket] = {}
        self._refused: deque[socket.socket] = deque()
        self._evictions = CostLimit(_EVICTIONS_AT_ONCE, _EVICTIONS_PER_S)

    def accept(self) -> tuple[socket.socket, Any]:
        """The next connection; some that are not even parked are closed until then."""
        for _ in range(_CLOSED_AT_ONCE):
            connection, peer = super().accept()
            place = Place(str(peer[0]), time.monotonic())
            place.is_parked = not self._takes_place(place)
            if not place.is_parked or self._may_park(place.address):
                return self._accepted(connection, place, peer), peer
            self._refuse(connection)
        raise ConnectionAbortedError("too many connections")

    def _accepted(self, connection: socket.socket, place: Place, peer: Any) -> socket.socket:
        places = self._parked if place.is_parked else self._open
        accepted = places[place] = _PlacedSocket(connection, (self._open, self._parked), place)
        if place.is_parked:
            asyncio.get_running_loop().call_later(_PARKED_S, self._unpark, place.address)
        LimitedProtocol.await_beginning(peer, accepted)
        return accepted

    def _takes_place(self, place: Place) -> bool:
        """Make room for it; False where its address has done that too often."""
        leaves, now_ns = gives_way(self._open.keys(), place.address), time.monotonic_ns()
        if leaves is None:
            return True
        if self._evictions.wait_ns(place.address, 1, now_ns):
            return False
        self._evictions.take(place.address, 1, now_ns)
        _end(self._open.pop(leaves))
        return True

    def _refuse(self, connection: socket.socket) -> None:
        """Close it a second later, or at once where too many wait for that."""
        if len(self._refused) < MOST_REFUSED:
            self._refused.append(connection)
            asyncio.get_running_loop().call_later(_REFUSED_S, self._close_refused)
        else:
            connection.close()

    def _close_refused(self) -> None:
        self._refused.popleft().close()

    def _may_park(self, address: str) -> bool:
        own = sum(place.address == address for place in self._parked)
        return len(self._parked) < MOST_PARKED and own < MOST_PARKED_PER_ADDRESS

    def _unpark(self, address: str) -> None:
        """Give the first one of this address a place, if that may be now; else look again."""
        own = [place for place in self._parked if place.address == address]
        if not own:
            return
        if self._takes_place(own[0]):
            self._open[own[0]] = self._parked.pop(own[0])
            own[0].unpark()
        if len(own) > 1 or own[0].is_parked:
            asyncio.get_running_loop().call_later(_PARKED_S, self._unpark, address)


class _PlacedSocket(socket.socket):
    """Accepted connection, which has a place until it is closed or gave way."""

    def __init__(
        self,
        accepted: socket.socket,
        registers: tuple[dict[Place, socket.socket], ...],
        place: Place,
    ) -> None:
        super().__init__(accepted.family, accepted.type, accepted.proto, accepted.detach())
        self._registers = registers
        self.place = place

    def close(self) -> None:
        for register in self._registers:
            register.pop(self.place, None)
        super().close()


def _end(accepted: socket.socket) -> None:
    """End a connection; asyncio sees that and closes it."""
    with contextlib.suppress(OSError):  # it has ended by itself
        accepted.shutdown(socket.SHUT_RDWR)


def _placed(app: ASGIApp, transport: asyncio.Transport, place: Place) -> ASGIApp:
    async def wrapped(scope: Scope, receive: Receive, send: Send) -> None:
        own = {_TRANSPORT: transport, _PLACE: place}
        scope["extensions"] = {**(scope.get("extensions") or {}), **own}
        path = scope.get("path", "")
        await place.wait_for(path)
        with place.asked(path):
            await app(scope, receive, send)

    return wrapped


class LimitedProtocol(H11Protocol):
    """HTTP/1.1 connection that is closed where no handshake or no request comes."""

    _beginning: ClassVar[dict[Any, _PlacedSocket]] = {}
    _timer: asyncio.TimerHandle | None = None

    @classmethod
    def await_beginning(cls, peer: Any, accepted: _PlacedSocket) -> None:
        """Close this connection where its TLS has not begun in time."""
        cls._beginning[peer] = accepted
        asyncio.get_running_loop().call_later(REQUEST_WITHIN_S, cls._give_up, peer, accepted)

    @classmethod
    def _give_up(cls, peer: Any, accepted: _PlacedSocket) -> None:
        if cls._beginning.get(peer) is accepted:
            del cls._beginning[peer]
            _end(accepted)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        accepted = self._beginning.pop(transport.get_extra_info("peername"), None)
        super().connection_made(transport)
        # One that has just been given up has no place any more.
        place = accepted.place if accepted is not None else Place("", time.monotonic())
        self.app = _placed(self.app, transport, place)
        self._watch(transport)

    def _watch(self, transport: asyncio.Transport) -> None:
        self._seen_cycle = self.cycle
        loop = asyncio.get_running_loop()
        self._timer = loop.call_later(REQUEST_WITHIN_S, self._check, transport)

    def _check(self, transport: asyncio.Transport) -> None:
        """Close it where nothing but a part of a request came since the last look."""
        waits = self.conn.their_state in (h11.IDLE, h11.SEND_BODY)
        if waits and self.cycle is self._seen_cycle:
            transport.abort()
        else:
            self._watch(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)
