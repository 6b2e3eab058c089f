"""Live view on a terminal, which is left as it was, whatever happens.

Textual writes to stderr and reads stdin. A signal ends the view in order; where that cannot be
done, because the terminal hangs or has gone away, the process ends by itself a moment later.
"""

import contextlib
import os
import signal
import sys
import termios
import threading
from collections.abc import Callable, Sequence
from typing import Any

from vcu_gateway import text
from vcu_gateway.watch.app import WatchApp
from vcu_gateway.watch.source import ViewSource

_EXIT_SIGNALS = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
_EXIT_TIMEOUT_S = 2.0


def is_full() -> bool:
    """True where the terminal can show a full-screen view and take keys."""
    streams = (sys.stdin, sys.stdout, sys.stderr)
    terminals = all(stream is not None and stream.isatty() for stream in streams)
    return terminals and os.environ.get("TERM", "dumb") not in ("", "dumb", "unknown")


class TerminalExit:
    """Exit request for the view; without an answer it ends the process after two seconds.

    SIGTERM, SIGHUP and SIGINT are the request: it is made only in the main thread.

    Attributes:
        requested: True from the first signal on, or the end of the terminal.
    """

    def __init__(self) -> None:
        self.requested = False
        self._attributes = _attributes()
        self._end = threading.Timer(_EXIT_TIMEOUT_S, self._enforce)
        self._end.daemon = True
        for number in _EXIT_SIGNALS:
            signal.signal(number, lambda *_: self.request())

    def request(self) -> None:
        """Have the view end; in two seconds the process does, whatever the view does."""
        if not self.requested:
            self.requested = True
            self._end.start()

    def finished(self) -> None:
        self._end.cancel()

    def _enforce(self) -> None:
        if self._attributes is not None:
            with contextlib.suppress(termios.error):  # it has gone
                termios.tcsetattr(0, termios.TCSANOW, self._attributes)
        os._exit(os.EX_OK)


def watch(
    source: ViewSource,
    title: str,
    finished: Callable[[], bool] = lambda: False,
    notes: Callable[[], Sequence[str]] = tuple,
) -> None:
    """Show the source until a key or a signal ends it, the terminal goes away, or `finished`.

    `notes` are lines below the title.
    Only in the main thread, and where `is_full`. The process ends with 70 after a bug.
    """
    terminal_exit = TerminalExit()

    def done() -> bool:
        if _attributes() is None:  # its window was closed, or ssh has died
            terminal_exit.request()
        return terminal_exit.requested or finished()

    app = WatchApp(source, title, done, notes=notes)
    # Without the mouse the terminal keeps its own way to select and copy.
    app.run(mouse=False)
    text.flush()  # the terminal may be gone
    terminal_exit.finished()
    if app.return_code:
        raise SystemExit(os.EX_SOFTWARE)


def _attributes() -> list[Any] | None:
    try:
        return termios.tcgetattr(0)
    except termios.error:
        return None
