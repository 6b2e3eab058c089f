"""The page as an ASGI application: settings -> link, access, routes, guard.

When a certificate ends; the standard library reads that of a peer alone, never its own.

HTTP server of the page: its socket, its limits, and the end by a signal.
"""

import asyncio
import contextlib
import re
import signal
import socket
import ssl
import sys
from collections.abc import AsyncIterator, Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp

from vcu_gateway.errors import ConfigError, Problem, UnavailableError
from vcu_gateway.web.access import Access
from vcu_gateway.web.connections import LimitedListener, LimitedProtocol
from vcu_gateway.web.gateway_link import GatewayLink
from vcu_gateway.web.guard import Guard, PageRequestError
from vcu_gateway.web.page_files import page_files
from vcu_gateway.web.recordings import RecordingRoutes
from vcu_gateway.web.routes import Actions, Routes
from vcu_gateway.web.settings import WebSettings
from vcu_gateway.web.stream import Broadcast, Streams
from vcu_gateway.web.users import WebEvents

_ENDS_SOON = timedelta(days=30)
_LOOK_EVERY_S = 3600.0
_PEM = re.compile("-----BEGIN CERTIFICATE-----.+?-----END CERTIFICATE-----", re.DOTALL | re.ASCII)
_CONTEXT_0, _UTC_TIME = 0xA0, 0x17
_BEFORE_VALIDITY = 3  # serial number, signature, issuer


def end_of(chain: Path) -> datetime:
    """When the first certificate of this PEM file's chain ends; ValueError where none is there."""
    pems = _PEM.findall(chain.read_text())
    try:
        return min(_not_after(ssl.PEM_cert_to_DER_cert(pem)) for pem in pems)
    except (LookupError, ValueError, RuntimeError, StopIteration) as error:
        raise ValueError(f"{chain} has no certificate that can be read") from error


async def watch(end: datetime, tell: Callable[[str], None]) -> None:
    """Tell a person of the end while it is near, until cancelled."""
    told: str | None = None
    while True:
        sentence = ending_sentence(end, datetime.now(UTC))
        if sentence is not None and sentence != told:
            told = sentence
            tell(sentence)
        await asyncio.sleep(_LOOK_EVERY_S)


def ending_sentence(end: datetime, now: datetime) -> str | None:
    """What a person is to know of a certificate near its end; None before that."""
    left = end - now
    if left > _ENDS_SOON:
        return None
    verb = "ends" if left > timedelta(0) else "ended"
    return f"The certificate {verb} on {end:%Y-%m-%d %H:%M} UTC: replace it."


def _not_after(der: bytes) -> datetime:
    """Field notAfter of X.509 (RFC 5280, 4.1): the second time of validity."""
    certificate = next(_values(der))[1]
    fields = list(_values(next(_values(certificate))[1]))
    if fields[0][0] == _CONTEXT_0:  # the version, which may be left out
        fields = fields[1:]
    _, (kind, text) = _values(fields[_BEFORE_VALIDITY][1])
    return _time(text.decode("ascii"), is_short=kind == _UTC_TIME)


def _time(text: str, *, is_short: bool) -> datetime:
    """UTCTime has two digits of the year, 50 to 99 those of the last century."""
    if is_short:
        text = ("19" if text >= "50" else "20") + text
    return datetime.strptime(text, "%Y%m%d%H%M%SZ").replace(tzinfo=UTC)


def _values(der: bytes) -> Iterator[tuple[int, bytes]]:
    """Tag and content of each value in these bytes; ValueError where they are no DER."""
    at = 0
    while at < len(der):
        tag, length, at = der[at], der[at + 1], at + 2
        if length & 0x80:
            size = length & 0x7F
            length, at = int.from_bytes(der[at : at + size], "big"), at + size
        if at + length > len(der):
            raise ValueError("no DER")
        yield tag, der[at : at + length]
        at += length


def build(settings: WebSettings, events: WebEvents) -> ASGIApp:
    """The whole application; its lifespan follows the gateway."""
    broadcast = Broadcast()
    link = GatewayLink(settings.socket_path, broadcast, events)
    events.on_change = link.answers.note_event
    actions = Actions(settings.socket_path)
    access = Access(settings, events)
    api = Routes(access, link, actions, Streams(broadcast), events)
    recordings = RecordingRoutes(settings.recordings, events)

    @contextlib.asynccontextmanager
    async def lifespan(_: Starlette) -> AsyncIterator[None]:
        tasks = [asyncio.create_task(link.run()), *_certificate_watch(settings, link)]
        try:
            yield
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await actions.close()
            await link.close()

    of_files = [Route(path, file.response) for path, file in page_files().items()]
    routes = [*_api_routes(api, recordings), *of_files]
    starlette = Starlette(
        routes=routes, lifespan=lifespan, exception_handlers={PageRequestError: _refused}
    )
    starlette.router.redirect_slashes = False  # a path is one of the routes, or none
    return Guard(starlette, settings)


async def _refused(_: Request, refused: Any) -> Response:
    response: Response = refused.response
    return response


def _certificate_watch(settings: WebSettings, link: GatewayLink) -> list[asyncio.Task[None]]:
    if settings.tls is None:
        return []
    with contextlib.suppress(OSError, ValueError):  # TLS itself has taken it, or said why not
        end = end_of(settings.tls.certificate)
        return [asyncio.create_task(watch(end, link.tell_certificate))]
    return []


def _api_routes(api: Routes, recordings: RecordingRoutes) -> list[Route]:
    visitors = api.for_visitors
    return [
        Route("/api/session", api.session, methods=["GET"]),
        Route("/api/session", api.sign_in, methods=["POST"]),
        Route("/api/session", api.sign_out, methods=["DELETE"]),
        Route("/api/clock", visitors(api.clock)),
        Route("/api/stream", visitors(api.stream)),
        Route("/api/history", visitors(api.history)),
        Route("/api/actions/{name}", api.act, methods=["POST"]),
        Route("/api/tuning", visitors(api.tuning)),
        Route("/api/drive-mode", visitors(api.set_drive_mode), methods=["POST"]),
        Route("/api/recordings", visitors(recordings.listed)),
        Route("/api/recordings/{kind}/{name}/download", visitors(recordings.download)),
        Route(
            "/api/recordings/{kind}/{name}/replay", visitors(recordings.replay), methods=["POST"]
        ),
        Route(
            "/api/recordings/{kind}/{name}/what-if", visitors(recordings.what_if), methods=["POST"]
        ),
    ]


_BACKLOG = 128
_SEND_BUFFER_BYTES = 64 * 1024
_HEAD_BYTES = 16 * 1024
_UNREAD_FOR_MS = 30_000
# Samples are put together on a thread, which a stop is not to wait for: Python's own is 5 ms.
_SWITCH_S = 0.0005


def listening_socket(settings: WebSettings) -> LimitedListener:
    """Socket of the address; UnavailableError, with a remedy, where it cannot be had."""
    family = socket.AF_INET6 if ":" in settings.address else socket.AF_INET
    listener = LimitedListener(family)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # Inherited by each connection: a slow browser is to miss updates, not to get old ones.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        # A phone that has left the network makes room, and not only after a quarter of an hour.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, _UNREAD_FOR_MS)
        listener.bind((settings.address, settings.port))
        listener.listen(_BACKLOG)
    except OSError as error:
        listener.close()
        what = f"cannot listen on {settings.address} port {settings.port}: {error.strerror}"
        remedy = "see who has it: ss -ltnp; or give another one with --listen"
        raise UnavailableError(Problem(what, remedy=remedy)) from error
    return listener


class _Server(uvicorn.Server):
    """Ends in order by a signal: uvicorn's own raises it once more at the end."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Stop at SIGINT and SIGTERM, until the end of the block."""
        numbers = (signal.SIGINT, signal.SIGTERM)
        before = {number: signal.signal(number, self.handle_exit) for number in numbers}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def run(settings: WebSettings, app: ASGIApp, on_open: Callable[[str], None]) -> None:
    """Serve until SIGINT or SIGTERM; `on_open` is told where browsers find it."""
    sys.setswitchinterval(_SWITCH_S)
    with listening_socket(settings) as listener:
        config = uvicorn.Config(
            app,
            loop="asyncio",  # others do not ask the listener
            http=LimitedProtocol,
            ws="none",
            lifespan="on",
            log_config=None,
            log_level="critical",
            access_log=False,
            server_header=False,
            proxy_headers=False,
            timeout_keep_alive=5,
            timeout_graceful_shutdown=1,
            h11_max_incomplete_event_size=_HEAD_BYTES,
        )
        if settings.tls is not None:
            config.ssl_certfile = str(settings.tls.certificate)
            config.ssl_keyfile = str(settings.tls.key)
        _load(config, settings)
        on_open(settings._replace(port=listener.getsockname()[1]).url)
        _Server(config).run(sockets=[listener])


def _load(config: uvicorn.Config, settings: WebSettings) -> None:
    """Read the certificate; ConfigError where it and its key are none, or do not fit."""
    try:
        config.load()
    except (ssl.SSLError, OSError) as error:
        where = str(settings.tls.certificate) if settings.tls else ""
        what = f"certificate and key cannot be used: {error}"
        raise ConfigError(Problem(what, where, "both are PEM and belong together")) from error
    if config.ssl is not None:
        config.ssl.minimum_version = ssl.TLSVersion.TLSv1_2
