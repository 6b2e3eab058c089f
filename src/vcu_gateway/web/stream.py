"""Server-sent events: what has changed, to each browser as fast as it reads."""

import asyncio
import time
from collections import Counter

from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from vcu_gateway.web.access import Visitor
from vcu_gateway.web.broadcast import Broadcast, Seen

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
        del scope
        address = self._visitor.address
        self._counts[address] += 1
        gone = asyncio.create_task(_until_gone(receive))
        try:
            await send({"type": "http.response.start", "status": 200, "headers": _HEADERS})
            await self._send_sections(send, gone)
        finally:
            gone.cancel()
            self._counts[address] -= 1
            if not self._counts[address]:
                del self._counts[address]

    async def _send_sections(self, send: Send, gone: "asyncio.Task[None]") -> None:
        seen, begin = Seen(), _RETRY
        while not gone.done() and not self._has_ended():
            body = begin + self._broadcast.unseen(seen)
            # Where the browser does not read, this waits, and what comes meanwhile is left out.
            await send({"type": "http.response.body", "body": body, "more_body": True})
            begin = b""
            await self._broadcast.wait()
        await send({"type": "http.response.body", "body": b"", "more_body": False})

    def _has_ended(self) -> bool:
        expires_s = self._visitor.expires_s
        return expires_s is not None and time.time() >= expires_s


async def _until_gone(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
