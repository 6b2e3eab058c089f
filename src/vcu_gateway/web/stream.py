"""Server-sent events: what has changed, to each browser as fast as its network takes it."""

import asyncio
import contextlib
import time
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from vcu_gateway.web.broadcast import GZIP_HEAD, Broadcast, SeenVersions, packed
from vcu_gateway.web.connections import undelivered_bytes

MOST_STREAMS = 128
MOST_STREAMS_PER_ADDRESS = 48

_HEADERS = {
    "cache-control": "no-store, no-transform",
    "vary": "accept-encoding",
    "x-accel-buffering": "no",
}
_RETRY = b"retry: 500\n\n"
_LOOK_AGAIN_S = 1.0
_MOST_UNDELIVERED_BYTES = 2048  # about three packed states


class Streams:
    """Open streams, counted; the tabs of one browser share one."""

    def __init__(self, broadcast: Broadcast) -> None:
        self._broadcast = broadcast
        self._by_address: Counter[str] = Counter()

    def response(
        self, request: Request, address: str, may_look: Callable[[], bool]
    ) -> Response | None:
        """A stream for whoever may look; None where there is no room for a further one."""
        is_full = self._by_address.total() >= MOST_STREAMS
        if is_full or self._by_address[address] >= MOST_STREAMS_PER_ADDRESS:
            return None
        as_gzip = "gzip" in request.headers.get("accept-encoding", "")
        headers = {**_HEADERS, "content-encoding": "gzip"} if as_gzip else _HEADERS
        kind = "text/event-stream"
        if request.method == "HEAD":
            return Response(headers=headers, media_type=kind)
        body = self._sections(request, address, may_look, as_gzip=as_gzip)
        return StreamingResponse(body, headers=headers, media_type=kind)

    async def _sections(
        self, request: Request, address: str, may_look: Callable[[], bool], *, as_gzip: bool
    ) -> AsyncIterator[bytes]:
        """Everything, then what is new, until the browser leaves or may look no more.

        What its network has not delivered yet makes it miss the next ones.
        """
        seen, look_again_s = SeenVersions(), time.monotonic() + _LOOK_AGAIN_S
        with self._counted(address), self._broadcast.read():
            yield GZIP_HEAD + packed(_RETRY) if as_gzip else _RETRY
            while True:
                change = self._broadcast.next_change
                if undelivered_bytes(request.scope) <= _MOST_UNDELIVERED_BYTES and (
                    body := self._broadcast.unseen(seen, as_gzip=as_gzip)
                ):
                    yield body
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(_LOOK_AGAIN_S):
                        await change.wait()
                if time.monotonic() >= look_again_s:
                    look_again_s = time.monotonic() + _LOOK_AGAIN_S
                    if not may_look():
                        return

    @contextlib.contextmanager
    def _counted(self, address: str) -> Iterator[None]:
        self._by_address[address] += 1
        try:
            yield
        finally:
            self._by_address[address] -= 1
            if not self._by_address[address]:
                del self._by_address[address]
