"""HTTP connections with limits that uvicorn has not: on their number, and on a slow beginning."""

import asyncio
from collections import Counter
from typing import ClassVar

import h11
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

MOST_CONNECTIONS = 256
MOST_PER_ADDRESS = 128
REQUEST_WITHIN_S = 10.0


TRANSPORT = "vcu_gateway.transport"
"""Extension of the scope: the connection itself, for a stream that writes without a task."""


def _with_transport(app: ASGIApp, transport: asyncio.Transport) -> ASGIApp:
    async def wrapped(scope: Scope, receive: Receive, send: Send) -> None:
        scope["extensions"] = {**(scope.get("extensions") or {}), TRANSPORT: transport}
        await app(scope, receive, send)

    return wrapped


class LimitedProtocol(H11Protocol):
    """HTTP/1.1 connection that is closed where there are too many, or where no request comes.

    The limit on one address keeps room for others: whoever wants to stop the vehicle gets in.
    """

    by_address: ClassVar[Counter[str]] = Counter()
    _address = ""
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take it, or close it at once."""
        peer = transport.get_extra_info("peername")
        self._address = str(peer[0]) if peer else ""
        self.by_address[self._address] += 1
        super().connection_made(transport)
        too_many = self.by_address.total() > MOST_CONNECTIONS
        if too_many or self.by_address[self._address] > MOST_PER_ADDRESS:
            transport.abort()
            return
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
        """Make room."""
        self.by_address[self._address] -= 1
        if not self.by_address[self._address]:
            del self.by_address[self._address]
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)
