"""Server: the API's thread and its listening socket.

A bug in here or in the service ends the thread, not the program: nothing is caught, the
traceback goes to stderr, every connection ends and with it its demand, and the socket closes.
`Server.failed` then has the exception, which the daemon logs; the ticks go on without an API:
the torque path does not depend on this thread.
"""

import contextlib
import sys
import threading

from vcu_gateway.api.results import ApiCounts
from vcu_gateway.server.acceptor import Acceptor, UnixListener
from vcu_gateway.server.event_loop import EventLoop
from vcu_gateway.server.service import Counters, ReplyQueue, RequestService, ServerSettings
from vcu_gateway.server.tick_gaps import TickGaps

_JOIN_S = 3.0


class Server:
    """Local API server: `open`, then `start`, and `close` at the end.

    Attributes:
        failed: exception that ended the thread, as text; None while there was none.
    """

    def __init__(self, settings: ServerSettings, service: RequestService, gaps: TickGaps) -> None:
        self._settings = settings
        self._service = service
        self._gaps = gaps
        self._counters = Counters()
        self._replies = ReplyQueue()
        self._listener: UnixListener | None = None
        self._thread: threading.Thread | None = None
        self._is_closing = False
        self.failed: str | None = None

    def counts(self) -> ApiCounts:
        """Counters of the API; from any thread."""
        return self._counters.report()

    def open(self) -> None:
        """Listen; UnavailableError, with what to do, where that cannot be."""
        self._listener = UnixListener(self._settings)

    def start(self) -> None:
        """Serve on a thread of its own; after `open`."""
        self._thread = threading.Thread(target=self._run, name="api", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Send pending replies, for a short while, and end; from any thread but the server's."""
        self._is_closing = True
        self._replies.wake()
        if self._thread is not None:
            self._thread.join(_JOIN_S)
        self._close_listener()

    def _run(self) -> None:
        try:
            with contextlib.closing(self._event_loop()) as loop:
                while not self._is_closing:
                    loop.run_once()
                self._close_listener()
                loop.finish()
        finally:
            if sys.exception() is not None:
                # As text: the exception would keep every connection alive.
                self.failed = repr(sys.exception())
            self._replies.close()
            self._close_listener()

    def _event_loop(self) -> EventLoop:
        if self._listener is None:
            raise AssertionError("open comes before start")
        acceptor = Acceptor(self._listener.sock, self._settings, self._counters)
        limits, counters = self._settings.limits, self._counters
        return EventLoop(self._service, self._gaps, limits, acceptor, self._replies, counters)

    def _close_listener(self) -> None:
        if self._listener is not None:
            self._listener.close()
