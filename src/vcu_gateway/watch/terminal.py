"""The terminal that a full-screen view needs, and leaving it whatever happens.

Textual writes to stderr and reads stdin. A signal ends the view in order; where that cannot be
done, because the terminal hangs or has gone away, the process ends by itself a moment later.
"""

import os
import signal
import sys
import termios
import threading
from types import FrameType
from typing import Any

_ENDING = (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)
_PATIENCE_S = 2.0


def is_full() -> bool:
    """True where the terminal can show a full-screen view and take keys."""
    streams = (sys.stdin, sys.stdout, sys.stderr)
    terminals = all(stream is not None and stream.isatty() for stream in streams)
    return terminals and os.environ.get("TERM", "dumb") not in ("", "dumb", "unknown")


def has_gone() -> bool:
    """True where the terminal was hung up: its window was closed, or ssh has died."""
    try:
        termios.tcgetattr(0)
    except termios.error:
        return True
    return False


class TerminalExit:
    """Notes that the view has to end, and sees to it that it does.

    Attributes:
        asked: True from the first signal on, or the end of the terminal.
    """

    def __init__(self) -> None:
        self.asked = False
        self._attributes = _attributes()
        self._finished = threading.Event()

    def handle_signals(self) -> None:
        """From now on SIGTERM, SIGHUP and SIGINT ask; only in the main thread."""
        for number in _ENDING:
            signal.signal(number, self._on_signal)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        del number, frame
        self.ask()

    def ask(self) -> None:
        """Have the view end; in two seconds the process does, whatever the view does."""
        if not self.asked:
            self.asked = True
            threading.Thread(target=self._insist, name="exit", daemon=True).start()

    def finished(self) -> None:
        """The view has ended and the terminal is as it was."""
        self._finished.set()

    def _insist(self) -> None:
        if self._finished.wait(_PATIENCE_S):
            return
        if self._attributes is not None:
            _restore(self._attributes)
        os._exit(os.EX_OK)


def _attributes() -> list[Any] | None:
    try:
        return termios.tcgetattr(0)
    except termios.error:
        return None


def _restore(attributes: list[Any]) -> None:
    try:
        termios.tcsetattr(0, termios.TCSANOW, attributes)
    except termios.error:
        return  # it has gone
