"""Connections with limits that uvicorn has not: on their number, and on a slow beginning."""

import asyncio
import contextlib
import socket
from collections import Counter
from typing import Any, ClassVar

import h11
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_CONNECTIONS = 256
MOST_PER_ADDRESS = 128
REQUEST_WITHIN_S = 10.0


TRANSPORT = "vcu_gateway.transport"
"""Extension of the scope: the connection itself, for a stream that writes without a task."""


class LimitedListener(socket.socket):
    """Listening socket that closes a connection at once where there are too many.

    It counts what it accepted, whether TLS has begun on it or not. The limit on one address keeps
    room for others: whoever wants to stop the vehicle gets in.
    """

    def __init__(self, family: socket.AddressFamily) -> None:
        super().__init__(family, socket.SOCK_STREAM)
        self._by_address: Counter[str] = Counter()

    def accept(self) -> tuple[socket.socket, Any]:
        """The next connection; ConnectionAbortedError for one that was too many."""
        connection, peer = super().accept()
        address = str(peer[0])
        of_address = self._by_address[address]
        if self._by_address.total() >= MOST_CONNECTIONS or of_address >= MOST_PER_ADDRESS:
            connection.close()
            raise ConnectionAbortedError("too many connections")
        counted = _CountedSocket(connection, self._by_address, address)
        LimitedProtocol.await_beginning(peer, counted)
        return counted, peer


class _CountedSocket(socket.socket):
    """Accepted connection, counted until it is closed."""

    def __init__(self, accepted: socket.socket, counts: Counter[str], address: str) -> None:
        family, kind, protocol = accepted.family, accepted.type, accepted.proto
        super().__init__(family, kind, protocol, fileno=accepted.detach())
        self._counts: Counter[str] | None = counts
        self._address = address
        counts[address] += 1

    def close(self) -> None:
        """Close it, and make room."""
        counts, self._counts = self._counts, None
        if counts is not None:
            counts[self._address] -= 1
            if not counts[self._address]:
                del counts[self._address]
        super().close()


def _with_transport(app: ASGIApp, transport: asyncio.Transport) -> ASGIApp:
    async def wrapped(scope: Scope, receive: Receive, send: Send) -> None:
        scope["extensions"] = {**(scope.get("extensions") or {}), TRANSPORT: transport}
        await app(scope, receive, send)

    return wrapped


class LimitedProtocol(H11Protocol):
    """HTTP/1.1 connection that is closed where no handshake or no request comes."""

    _beginning: ClassVar[dict[Any, socket.socket]] = {}
    _timer: asyncio.TimerHandle | None = None

    @classmethod
    def await_beginning(cls, peer: Any, accepted: socket.socket) -> None:
        """Close this connection where its TLS has not begun in time."""
        cls._beginning[peer] = accepted
        asyncio.get_running_loop().call_later(REQUEST_WITHIN_S, cls._give_up, peer, accepted)

    @classmethod
    def _give_up(cls, peer: Any, accepted: socket.socket) -> None:
        if cls._beginning.get(peer) is accepted:
            del cls._beginning[peer]
            with contextlib.suppress(OSError):  # it has ended by itself
                accepted.shutdown(socket.SHUT_RDWR)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take it, and watch over its beginning."""
        self._beginning.pop(transport.get_extra_info("peername"), None)
        super().connection_made(transport)
        self.app = _with_transport(self.app, transport)
        self._seen_cycle = self.cycle
        self._watch(transport)

    def _watch(self, transport: asyncio.Transport) -> None:
        loop = asyncio.get_running_loop()
        self._timer = loop.call_later(REQUEST_WITHIN_S, self._check, transport)

    def _check(self, transport: asyncio.Transport) -> None:
        """Close it where nothing but a part of a request came since the last look."""
        waits = self.conn.their_state in (h11.IDLE, h11.SEND_BODY)
        if waits and self.cycle is self._seen_cycle:
            transport.abort()
            return
        self._seen_cycle = self.cycle
        self._watch(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """Watch no more."""
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)
