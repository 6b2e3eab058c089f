"""Server-sent events: what has changed, to each browser as fast as its network takes it.

Latest values for all browsers: sections, each encoded once, and whoever is slow skips some.
"""

import asyncio
import contextlib
import json
import time
import zlib
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from functools import cached_property

from starlette.requests import Request
from starlette.responses import Response, StreamingResponse

from vcu_gateway.web.connections import counted, undelivered_bytes
from vcu_gateway.web.guard import PageRequestError

GZIP_HEAD = b"\x1f\x8b\x08\x00\x00\x00\x00\x00\x00\x03"
"""Begins the body of a browser that takes gzip (RFC 1952); packed sections follow."""


class _Section(bytes):
    @cached_property
    def packed(self) -> bytes:
        """Once for all browsers that take gzip."""
        return packed(self)


def packed(data: bytes) -> bytes:
    """A part of a gzip body: it refers to nothing before it, so that any such parts follow."""
    deflate = zlib.compressobj(wbits=-zlib.MAX_WBITS)
    return deflate.compress(data) + deflate.flush(zlib.Z_SYNC_FLUSH)


class Broadcast:
    """Sections by name, each the latest of its kind, as server-sent events.

    Nothing is queued: a browser that reads slowly gets the latest of each section when it has room.

    Attributes:
        is_read: set while a browser looks.
        next_change: set, and replaced, where there is something new.
    """

    def __init__(self) -> None:
        self._sections: dict[str, _Section] = {}
        self._readers = 0
        self.is_read = asyncio.Event()
        self.next_change = asyncio.Event()

    @contextlib.contextmanager
    def read(self) -> Iterator[None]:
        """A browser looks for as long as the block."""
        self._readers += 1
        self.is_read.set()
        try:
            yield
        finally:
            self._readers -= 1
            if not self._readers:
                self.is_read.clear()

    def publish(self, name: str, value: object, *, wake: bool = True) -> None:
        """Replace a section, and wake the browsers' streams; else it goes with the next that does.

        ValueError for a number that JSON has not.
        """
        text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
        self._sections[name] = _Section(f"event: {name}\ndata: {text}\n\n".encode())
        if wake:
            self.next_change.set()
            self.next_change = asyncio.Event()

    def forget(self, *names: str) -> None:
        """Leave sections out until they are published again."""
        for name in names:
            self._sections.pop(name, None)

    def unseen(self, seen: dict[str, bytes], *, as_gzip: bool = False) -> bytes:
        """Sections newer than those that this browser has seen; it has seen them from now on."""
        changed = {name: one for name, one in self._sections.items() if seen.get(name) is not one}
        seen.update(changed)
        return b"".join(one.packed if as_gzip else one for one in changed.values())


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

    def response(self, request: Request, address: str, may_look: Callable[[], bool]) -> Response:
        """A stream for whoever may look; PageRequestError where there is no room for it."""
        is_full = self._by_address.total() >= MOST_STREAMS
        if is_full or self._by_address[address] >= MOST_STREAMS_PER_ADDRESS:
            raise PageRequestError(503, "too many browsers look already")
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
        look_again_s = time.monotonic() + _LOOK_AGAIN_S
        seen: dict[str, bytes] = {}
        with counted(self._by_address, address), self._broadcast.read():
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
