"""The API's thread, and the sockets that it listens on.

A bug in here or in the service ends the thread, not the program: nothing is caught, the
traceback goes to stderr, every connection ends and with it its demand, and the sockets close.
`Server.failed` then says what it was, and the daemon logs that and drives on without an API:
the torque path does not depend on this thread.
"""

import contextlib
import socket
import sys
import threading
import time

from vcu_gateway.api.results import ApiCounts
from vcu_gateway.errors import UnavailableError
from vcu_gateway.server.acceptor import Acceptor
from vcu_gateway.server.counters import Counters
from vcu_gateway.server.event_loop import EventLoop
from vcu_gateway.server.reply_queue import ReplyQueue
from vcu_gateway.server.service import RequestService
from vcu_gateway.server.session import Limits
from vcu_gateway.server.settings import DEFAULT_LIMITS
from vcu_gateway.server.sockets import ServerSettings, UnixListener, listen_on_loopback
from vcu_gateway.server.tick_gaps import TickGaps

__all__ = ["Limits", "Server", "ServerSettings"]

_JOIN_S = 3.0


class Server:
    """The local API: `open`, `start`, and `close` at the end.

    Attributes:
        metrics_unavailable: why there is no port for metrics though it is wanted; else None.
    """

    def __init__(
        self,
        settings: ServerSettings,
        service: RequestService,
        gaps: TickGaps,
        limits: Limits = DEFAULT_LIMITS,
    ) -> None:
        self._settings = settings
        self._service = service
        self._gaps = gaps
        self._limits = limits
        self._counters = Counters()
        self._mailbox = ReplyQueue()
        self._door: UnixListener | None = None
        self._metrics_sock: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._is_closing = False
        self._failed: str | None = None
        self.metrics_unavailable: str | None = None

    @property
    def failed(self) -> str | None:
        """The exception that ended the thread; None while there was none."""
        return self._failed

    @property
    def metrics_port(self) -> int | None:
        """The port that is listened on; None where there is none."""
        return None if self._metrics_sock is None else self._metrics_sock.getsockname()[1]

    @property
    def delayed(self) -> int:
        """Requests that had to wait because their connection sent too many."""
        return self._counters.delayed

    def counts(self) -> ApiCounts:
        """The API's own figures; from any thread."""
        return self._counters.report()

    def open(self) -> None:
        """Listen; UnavailableError, with what to do, where that cannot be.

        A port for metrics that cannot be had is no reason to go without the rest: see
        `metrics_unavailable`.
        """
        self._door = UnixListener(self._settings)
        if self._settings.metrics_port is not None:
            try:
                self._metrics_sock = listen_on_loopback(self._settings.metrics_port)
            except UnavailableError as error:
                self.metrics_unavailable = str(error)

    def start(self) -> None:
        """Serve, on a thread of its own; after `open`."""
        self._thread = threading.Thread(target=self._run, name="api", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Answer what is pending, for a short while, and end; from any thread but its own."""
        self._is_closing = True
        self._mailbox.ring()
        if self._thread is not None:
            self._thread.join(_JOIN_S)
        self._close_doors()

    def _run(self) -> None:
        try:
            with contextlib.closing(self._rounds()) as rounds:
                while not self._is_closing:
                    rounds.round()
                self._close_doors()
                rounds.wind_up()
        finally:
            if sys.exception() is not None:
                # As text: the exception would keep every connection alive.
                self._failed = repr(sys.exception())
            self._mailbox.shut()
            self._close_doors()

    def _rounds(self) -> EventLoop:
        return EventLoop(
            self._service,
            self._gaps,
            self._limits,
            self._receptions(),
            self._mailbox,
            self._counters,
        )

    def _receptions(self) -> list[Acceptor]:
        now_ns = time.monotonic_ns()
        policy, limits, counters = self._settings.policy, self._limits, self._counters
        receptions = []
        if self._door is not None:
            sock = self._door.sock
            receptions.append(Acceptor(sock, False, policy, limits, counters, now_ns))
        if self._metrics_sock is not None:
            sock = self._metrics_sock
            receptions.append(Acceptor(sock, True, policy, limits, counters, now_ns))
        return receptions

    def _close_doors(self) -> None:
        if self._door is not None:
            self._door.close()
        if self._metrics_sock is not None:
            self._metrics_sock.close()
