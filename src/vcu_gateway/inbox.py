"""Work for the ticking thread, handed over by other threads.

The ticking thread alone asks the gateway for anything: it takes this work between its ticks.
"""

import queue
import time
from collections.abc import Callable

Work = Callable[[], None]

_MUCH = 256
_AT_ONCE = 32
_NS_PER_S = 1_000_000_000


class Inbox:
    """A queue of work, safe to fill from any thread and from signal handlers."""

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Work] = queue.SimpleQueue()

    @property
    def full(self) -> bool:
        """True where so much waits that whoever may be refused should be."""
        return self._queue.qsize() >= _MUCH

    def post(self, work: Work) -> None:
        """Have this done soon, in the order of posting."""
        self._queue.put(work)

    def do_waiting(self) -> None:
        """Do what waits, but only so much: what follows must not be late."""
        for _ in range(min(self._queue.qsize(), _AT_ONCE)):
            self._queue.get_nowait()()

    def do_until(self, end_ns: int) -> None:
        """Do work as it comes in, until this time."""
        while (left_ns := end_ns - time.monotonic_ns()) > 0:
            try:
                work = self._queue.get(timeout=left_ns / _NS_PER_S)
            except queue.Empty:
                return
            work()
