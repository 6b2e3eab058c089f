"""HTTP server of the page: its socket, its limits, and the end by a signal."""

import contextlib
import signal
import socket
import ssl
import sys
from collections.abc import Callable, Iterator

import uvicorn
from starlette.types import ASGIApp

from vcu_gateway.errors import ConfigError, Problem, UnavailableError
from vcu_gateway.web.connections import LimitedListener, LimitedProtocol
from vcu_gateway.web.settings import WebSettings

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
