"""Guard before every route: Host, Origin, size of the body, and the headers of every answer.

A page of another site can make a browser send requests here, with its cookies: it must not get
anything done by that, nor read anything (docs/web.md).

Limit on questions: what each costs, by address and by session; a stop is done at once.
"""

import asyncio
import re
import time
from collections.abc import Mapping

from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from vcu_gateway.units import NS_PER_S
from vcu_gateway.web.connections import SESSION, STOPS, CostLimit
from vcu_gateway.web.settings import WebSettings, without_port

HISTORY = "/api/history"
NO_STORE = {"cache-control": "no-store"}

_LONGEST_WAIT_NS = NS_PER_S
_COSTS = {HISTORY: 20}


class QuestionLimit:
    """Limits of an address and of a session.

    Who asks too much waits up to a second for an answer, and is then refused: a connection that
    asks without end has one answer a second. A stop and signing in are never held up, but the
    answers to them are, where one session, or one address without any, asks without end.
    """

    def __init__(self) -> None:
        self._addresses = CostLimit(burst=300, per_s=60)
        self._sessions = CostLimit(burst=200, per_s=40)
        self._stops = CostLimit(burst=20, per_s=10)

    async def take_turn(self, scope: Scope) -> None:
        """Wait for the turn of this request; PageRequestError where that is too far."""
        cost = cost_of(scope["method"], scope["path"])
        if not cost:
            return
        wait_ns = self.wait_ns(_address(scope), _cookie(scope), cost, time.monotonic_ns())
        await _wait(wait_ns)
        if wait_ns > _LONGEST_WAIT_NS:
            sentence = "too many questions: try again in a second"
            raise PageRequestError(429, sentence, {"retry-after": "1"})

    async def hold_answer(self, scope: Scope) -> None:
        """Wait before the answer to a stop, where too many were asked for."""
        if not cost_of(scope["method"], scope["path"]):
            key, now_ns = _cookie(scope) or _address(scope), time.monotonic_ns()
            wait_ns = self._stops.wait_ns(key, 1, now_ns)
            if wait_ns <= _LONGEST_WAIT_NS:
                self._stops.take(key, 1, now_ns)
            await _wait(wait_ns)

    def wait_ns(self, address: str, cookie: str, cost: int, now_ns: int) -> int:
        """Time to wait; the cost is taken where it is no longer than a second."""
        keys = [(self._addresses, address)] + ([(self._sessions, cookie)] if cookie else [])
        wait_ns = max(limit.wait_ns(key, cost, now_ns) for limit, key in keys)
        if wait_ns <= _LONGEST_WAIT_NS:
            for limit, key in keys:
                limit.take(key, cost, now_ns)
        return wait_ns


async def _wait(wait_ns: int) -> None:
    """Wait so long, a second at most; not at all at 0: who has sent all is gone a moment later."""
    if wait_ns:
        await asyncio.sleep(min(wait_ns, _LONGEST_WAIT_NS) / NS_PER_S)


def cost_of(method: str, path: str) -> int:
    """Cost of a question; 0 for a stop and for signing in, which have limits of their own."""
    if method == "POST" and (path in STOPS or path == SESSION):
        return 0
    return _COSTS.get(path, 1)


def _address(scope: Scope) -> str:
    client = scope.get("client")
    return str(client[0]) if client else ""


def _cookie(scope: Scope) -> str:
    values = [value for name, value in scope["headers"] if name == b"cookie"]
    return b";".join(values).decode("latin-1")


MOST_BODY_BYTES = 256 * 1024

_READING = frozenset({"GET", "HEAD"})
_FOREIGN_SITES = frozenset({"cross-site", "same-site"})
_NUMBER = re.compile(r"[0-9]{1,9}")
_KNOWN_METHODS = _READING | {"POST", "DELETE"}
_CONTENT_POLICY = (
    "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none';"
    " object-src 'none'; img-src 'self' data:"
)
_HEADERS: Mapping[str, str] = {
    "content-security-policy": _CONTENT_POLICY,
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), microphone=(), geolocation=(), payment=(), usb=()",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
}
_TLS_HEADERS = {"strict-transport-security": "max-age=31536000"}


class PageRequestError(Exception):
    """A request is not carried out: status of HTTP, a sentence for the person, further headers."""

    def __init__(
        self, status: int, sentence: str, headers: Mapping[str, str] | None = None
    ) -> None:
        super().__init__(sentence)
        self.response = JSONResponse(
            {"sentence": sentence}, status, {**NO_STORE, **(headers or {})}
        )


class Guard:
    """ASGI middleware that lets through what a browser of this page sends, and nothing else."""

    def __init__(self, app: ASGIApp, settings: WebSettings) -> None:
        self._app = app
        self._limit = QuestionLimit()
        self._hosts = settings.known_hosts
        self._scheme = "https" if settings.tls else "http"
        headers = {**_HEADERS, **(_TLS_HEADERS if settings.tls else {})}
        self._headers = [(name.encode(), value.encode()) for name, value in headers.items()]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        guarded = self._with_headers(scope, send)
        try:
            self._check(scope)
            await self._limit.take_turn(scope)
        except PageRequestError as refused:
            await refused.response(scope, receive, guarded)
            return
        await self._app(scope, receive, guarded)

    def _with_headers(self, scope: Scope, send: Send) -> Send:
        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                await self._limit.hold_answer(scope)
                message = {**message, "headers": [*message.get("headers", ()), *self._headers]}
            await send(message)

        return guarded

    def _check(self, scope: Scope) -> None:
        """PageRequestError for a request that is not let through."""
        headers = _single(scope)
        if scope["method"] not in _KNOWN_METHODS:
            raise PageRequestError(405, "no such method here")
        if without_port(headers.get("host", "").lower()) not in self._hosts:
            raise PageRequestError(421, "this host is not known by that name (--host-name)")
        reads = scope["method"] in _READING
        if not (reads and scope["path"] == "/") and headers.get("sec-fetch-site") in _FOREIGN_SITES:
            raise PageRequestError(403, "another site may not ask for this")
        if not reads:
            self._check_change(headers)

    def _check_change(self, headers: Mapping[str, str]) -> None:
        """The same for a request that may change something."""
        if headers.get("origin", "").lower() != f"{self._scheme}://{headers['host'].lower()}":
            sentence = "the request comes from no page of this host (Origin)"
            raise PageRequestError(403, sentence)
        length = headers.get("content-length", "0")
        if not _NUMBER.fullmatch(length):
            raise PageRequestError(400, "Content-Length is no number")
        if int(length) > MOST_BODY_BYTES:
            raise PageRequestError(413, f"larger than {MOST_BODY_BYTES} bytes")


def _single(scope: Scope) -> Mapping[str, str]:
    """Headers that decide; PageRequestError where one of them is there twice."""
    headers: dict[str, str] = {}
    for name, value in scope["headers"]:
        word = name.decode("latin-1")
        if word in ("host", "origin", "content-length", "sec-fetch-site"):
            if word in headers:
                raise PageRequestError(400, "a header is there twice")
            headers[word] = value.decode("latin-1")
    return headers
