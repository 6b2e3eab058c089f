"""Server-sent events: what has changed, to each browser as fast as it reads."""

import asyncio
import contextlib
from collections import Counter

from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from vcu_gateway.web.access import Visitor
from vcu_gateway.web.broadcast import Broadcast, SeenVersions
from vcu_gateway.web.connections import TRANSPORT
from vcu_gateway.web.sessions import now_s

MOST_STREAMS = 128
MOST_STREAMS_PER_ADDRESS = 64

_HEADERS = [
    (b"content-type", b"text/event-stream; charset=utf-8"),
    (b"cache-control", b"no-store, no-transform"),
    (b"x-accel-buffering", b"no"),
]
_RETRY = b"retry: 500\n\n"


class Streams:
    """Open streams, counted."""

    def __init__(self, broadcast: Broadcast) -> None:
        self._broadcast = broadcast
        self._by_address: Counter[str] = Counter()

    @property
    def count(self) -> int:
        """Browsers that look now; the tabs of one share a stream."""
        return self._by_address.total()

    def response(self, visitor: Visitor) -> "StreamResponse | None":
        """A stream for this visitor; None where there is no room for a further one."""
        of_address = self._by_address[visitor.address]
        if self.count >= MOST_STREAMS or of_address >= MOST_STREAMS_PER_ADDRESS:
            return None
        return StreamResponse(self._broadcast, self._by_address, visitor)


class StreamResponse(Response):
    """Response that goes on until the browser leaves or its session ends."""

    def __init__(self, broadcast: Broadcast, counts: Counter[str], visitor: Visitor) -> None:
        super().__init__()
        self._broadcast = broadcast
        self._counts = counts
        self._visitor = visitor

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send what changes, until it ends."""
        address = self._visitor.address
        self._counts[address] += 1
        reader = _StreamWriter(self._broadcast, scope["extensions"][TRANSPORT])
        try:
            await send({"type": "http.response.start", "status": 200, "headers": _HEADERS})
            body = _RETRY + self._broadcast.unseen(reader.seen)
            await send({"type": "http.response.body", "body": body, "more_body": True})
            self._broadcast.readers.add(reader.write)
            await self._until_over(receive)
        finally:
            self._broadcast.readers.discard(reader.write)
            self._counts[address] -= 1
            if not self._counts[address]:
                del self._counts[address]
        await send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _until_over(self, receive: Receive) -> None:
        """Until the browser has gone or its session has ended."""
        expires_s = self._visitor.expires_s
        left_s = None if expires_s is None else max(0.0, expires_s - now_s())
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(_until_gone(receive), left_s)


class _StreamWriter:
    """One browser's end of the broadcast: chunks of HTTP/1.1, straight to its connection."""

    def __init__(self, broadcast: Broadcast, transport: asyncio.Transport) -> None:
        self.seen = SeenVersions()
        self._broadcast = broadcast
        self._transport = transport

    def write(self) -> None:
        """What is new, if the browser has read what was there; else it misses this one."""
        if self._transport.is_closing() or self._transport.get_write_buffer_size():
            return
        body = self._broadcast.unseen(self.seen)
        if body:
            self._transport.write(b"%x\r\n%b\r\n" % (len(body), body))


async def _until_gone(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
