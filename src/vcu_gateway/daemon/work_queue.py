"""Between the ticks: when the ticking thread reads the bus, and the work that other threads post.

The ticking thread alone changes the gateway: it runs this work between its ticks.
"""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Callable

from vcu_gateway.units import NS_PER_MS, NS_PER_S

# Half of what the kernel's usual receive buffer holds.
_BUSY_FRAMES = 139
_LEAD_MAX_NS = 4 * NS_PER_MS
# A stall moves the lead by an eighth of this.
_LONGER_MAX_NS = 400_000


class DrainPlan:
    """Everything is read shortly before each tick, and in mid-period while the bus is busy.

    Attributes:
        lead_ns: time that waking up and reading before a tick usually take; the thread is to wake
            so much earlier.
        busy: in the last period more frames were read than half the usual receive buffer holds.
    """

    def __init__(self) -> None:
        self.lead_ns = 0
        self.busy = False
        self._frames = 0

    def read_between(self, frames: int) -> None:
        self._frames = frames

    def read_before_tick(self, frames: int, took_ns: int) -> None:
        """Note frames that were read before a tick, and the time since the thread was to wake."""
        self.busy = self._frames + frames > _BUSY_FRAMES
        self._frames = 0
        longer_ns = min(took_ns, _LEAD_MAX_NS) - self.lead_ns
        self.lead_ns += min(longer_ns, _LONGER_MAX_NS) // 8


Work = Callable[[], None]

_MUCH = 256
_AT_ONCE = 32


class WorkQueue:
    """A queue of work, safe to fill from any thread and from signal handlers."""

    def __init__(self) -> None:
        self._waiting: deque[Work] = deque()
        # Not SimpleQueue.get(timeout=...): up to Python 3.12 it waits for ever where a signal
        # comes so late that its handler ends after the deadline. A lock looks at the time again.
        self._wakeup = threading.Lock()
        self._wakeup.acquire()

    @property
    def full(self) -> bool:
        """True from 256 waiting items on: a caller that can be refused is to be refused."""
        return len(self._waiting) >= _MUCH

    def post(self, work: Work) -> None:
        """Queue work, run in the order of posting."""
        self._waiting.append(work)
        with contextlib.suppress(RuntimeError):  # it is set already
            self._wakeup.release()

    def run_waiting(self) -> None:
        """Run what waits, at most 32 items: the tick that follows must not be late."""
        for _ in range(min(len(self._waiting), _AT_ONCE)):
            self._waiting.popleft()()

    def run_until(self, last_begin_ns: int, end_ns: int) -> None:
        """Run work as it comes in; return at `end_ns` of the monotonic clock.

        From `last_begin_ns` on none is begun.
        """
        while (left_ns := end_ns - (now_ns := time.monotonic_ns())) > 0:
            if self._waiting and now_ns < last_begin_ns:
                self._waiting.popleft()()
            else:
                self._wakeup.acquire(timeout=left_ns / NS_PER_S)
