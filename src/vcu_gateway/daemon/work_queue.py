"""Work for the ticking thread, handed over by other threads.

The ticking thread alone asks the gateway for anything: it takes this work between its ticks.
"""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable

from vcu_gateway.units import NS_PER_S

Work = Callable[[], None]

_MUCH = 256
_AT_ONCE = 32


class WorkQueue:
    """A queue of work, safe to fill from any thread and from signal handlers."""

    def __init__(self) -> None:
        self._waiting: deque[Work] = deque()
        # Not SimpleQueue.get(timeout=...): up to Python 3.12 it waits for ever where a signal
        # comes so late that its handler ends after the deadline. A lock looks at the time again.
        self._bell = threading.Lock()
        self._bell.acquire()

    @property
    def full(self) -> bool:
        """True where so much waits that whoever may be refused should be."""
        return len(self._waiting) >= _MUCH

    def post(self, work: Work) -> None:
        """Have this done soon, in the order of posting."""
        self._waiting.append(work)
        with contextlib.suppress(RuntimeError):  # it has been rung already
            self._bell.release()

    def do_waiting(self) -> None:
        """Do what waits, but only so much: what follows must not be late."""
        for _ in range(min(len(self._waiting), _AT_ONCE)):
            self._waiting.popleft()()

    def do_until(self, end_ns: int) -> None:
        """Do work as it comes in, until this time."""
        while (left_ns := end_ns - time.monotonic_ns()) > 0:
            if self._waiting:
                self._waiting.popleft()()
            elif not self._bell.acquire(timeout=left_ns / NS_PER_S):
                return
