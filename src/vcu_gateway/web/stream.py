"""Server-sent events: what has changed, to each browser as fast as its network takes it."""

import asyncio
import contextlib
import fcntl
import sys
import termios
from collections import Counter
from collections.abc import Callable

from starlette.datastructures import Headers
from starlette.responses import Response
from starlette.types import Receive, Scope, Send

from vcu_gateway.web.broadcast import GZIP_HEAD, Broadcast, SeenVersions, packed
from vcu_gateway.web.connections import TRANSPORT

MOST_STREAMS = 128
MOST_STREAMS_PER_ADDRESS = 48

_HEADERS = [
    (b"content-type", b"text/event-stream; charset=utf-8"),
    (b"cache-control", b"no-store, no-transform"),
    (b"vary", b"accept-encoding"),
    (b"x-accel-buffering", b"no"),
]
_RETRY = b"retry: 500\n\n"
_LOOK_AGAIN_S = 1.0
_MOST_UNDELIVERED_BYTES = 2048  # about three packed states


class Streams:
    """Open streams, counted."""

    def __init__(self, broadcast: Broadcast) -> None:
        self._broadcast = broadcast
        self._by_address: Counter[str] = Counter()

    @property
    def count(self) -> int:
        """Browsers that look now; the tabs of one share a stream."""
        return self._by_address.total()

    def response(self, address: str, may_look: Callable[[], bool]) -> "StreamResponse | None":
        """A stream for whoever may look; None where there is no room for a further one."""
        if self.count >= MOST_STREAMS or self._by_address[address] >= MOST_STREAMS_PER_ADDRESS:
            return None
        return StreamResponse(self._broadcast, self._by_address, address, may_look)


class StreamResponse(Response):
    """Response that goes on until the browser leaves, or may look no more."""

    def __init__(
        self,
        broadcast: Broadcast,
        counts: Counter[str],
        address: str,
        may_look: Callable[[], bool],
    ) -> None:
        super().__init__()
        self._broadcast = broadcast
        self._counts = counts
        self._address = address
        self._may_look = may_look

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send what changes, until it ends."""
        writer = _StreamWriter(self._broadcast, scope)
        await send({"type": "http.response.start", "status": 200, "headers": writer.headers})
        if scope["method"] != "HEAD":
            await self._go_on(writer, receive, send)
        await send({"type": "http.response.body", "body": b"", "more_body": False})

    async def _go_on(self, writer: "_StreamWriter", receive: Receive, send: Send) -> None:
        """Count it, and send what changes while it lasts."""
        self._counts[self._address] += 1
        try:
            await send({"type": "http.response.body", "body": writer.begin(), "more_body": True})
            self._broadcast.readers.add(writer.write)
            await self._until_over(receive)
        finally:
            self._broadcast.readers.discard(writer.write)
            self._counts[self._address] -= 1
            if not self._counts[self._address]:
                del self._counts[self._address]

    async def _until_over(self, receive: Receive) -> None:
        """Until the browser has gone, or its session: signed out, ended or given way."""
        while self._may_look():
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_LOOK_AGAIN_S):
                    await _until_gone(receive)
                    return


class _StreamWriter:
    """One browser's end of the broadcast: chunks of HTTP/1.1, straight to its connection.

    HTTP/1.0 has no chunks; its answer ends with the connection.
    """

    def __init__(self, broadcast: Broadcast, scope: Scope) -> None:
        self._seen = SeenVersions()
        self._broadcast = broadcast
        self._transport: asyncio.Transport = scope["extensions"][TRANSPORT]
        self._is_chunked = scope["http_version"] != "1.0"
        self._as_gzip = "gzip" in Headers(scope=scope).get("accept-encoding", "")

    @property
    def headers(self) -> list[tuple[bytes, bytes]]:
        """Of the answer."""
        return [*_HEADERS, (b"content-encoding", b"gzip")] if self._as_gzip else _HEADERS

    def begin(self) -> bytes:
        """The first part of the body: everything."""
        everything = self._unseen()
        return GZIP_HEAD + packed(_RETRY) + everything if self._as_gzip else _RETRY + everything

    def write(self) -> None:
        """What is new, if the network has delivered what was there; else it misses this one."""
        if self._transport.is_closing() or self._undelivered_bytes() > _MOST_UNDELIVERED_BYTES:
            return
        body = self._unseen()
        if body:
            self._transport.write(_chunk(body) if self._is_chunked else body)

    def _unseen(self) -> bytes:
        return self._broadcast.unseen(self._seen, as_gzip=self._as_gzip)

    def _undelivered_bytes(self) -> int:
        """What the other end has not acknowledged: what waits in the kernel grows old there."""
        unsent = self._transport.get_write_buffer_size()
        connection = self._transport.get_extra_info("socket")
        queued = fcntl.ioctl(connection.fileno(), termios.TIOCOUTQ, bytes(4))
        return unsent + int.from_bytes(queued, sys.byteorder)


def _chunk(body: bytes) -> bytes:
    return b"%x\r\n%b\r\n" % (len(body), body)


async def _until_gone(receive: Receive) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass
