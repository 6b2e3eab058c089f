"""Ticking thread: its processor and memory, when it reads the bus, and the work that others post.

The ticking thread alone changes the gateway: it runs this work between its ticks.
"""

import contextlib
import ctypes
import gc
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import NamedTuple

from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.units import NS_PER_MS, NS_PER_S

_LIBC = ctypes.CDLL(None, use_errno=True)
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_SWITCH_INTERVAL_S = 0.0005
_COLLECT_EVERY_TICKS = 1200


def lock_memory() -> None:
    """Lock every page in memory (mlockall), so that no tick waits for the disk.

    Pages that are never touched cost nothing.

    Raises UnavailableError where the limit on locked memory does not allow it.
    """
    if _LIBC.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        what = f"memory cannot be locked: {os.strerror(ctypes.get_errno())}"
        remedy = "raise the limit (LimitMEMLOCK= of the service, ulimit -l)"
        raise UnavailableError(Problem(what, remedy=remedy))


@contextlib.contextmanager
def few_pauses() -> Iterator[None]:
    """Short switch interval, and no garbage collection but by `collect_after`, within the block.

    What is there at its beginning is not looked at again within the block, nor collected before:
    a start leaves some hundred objects as garbage, and finding them would delay the first tick.
    The switch interval stays.
    """
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    was_enabled = gc.isenabled()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()
        gc.unfreeze()


def collect_after(tick_index: int) -> None:
    """Collect garbage once a minute, right after a tick, when nothing is due."""
    if tick_index % _COLLECT_EVERY_TICKS == _COLLECT_EVERY_TICKS - 1:
        gc.collect()


_SCHEDSTAT = "/proc/thread-self/schedstat"


class ProcessorUsage(NamedTuple):
    """Processor time of one interval.

    Attributes:
        over_ns: length of the interval.
        processor_ns: processor time of the whole process.
        waited_ns: how long the asking thread was ready to run and had no processor; None where
            the kernel does not count it.
    """

    over_ns: int
    processor_ns: int
    waited_ns: int | None


class ProcessorTime:
    """Counter of one thread and its process, read by that thread; it keeps one file open."""

    def __init__(self) -> None:
        self._file: int | None = None
        with contextlib.suppress(OSError):
            self._file = os.open(_SCHEDSTAT, os.O_RDONLY | os.O_CLOEXEC)
        self._last = self._read()

    def since_last(self) -> ProcessorUsage:
        """Processor time since the last call, or since the beginning; a file is read."""
        before, now = self._last, self._read()
        self._last = now
        waited_ns = None
        if now.waited_ns is not None and before.waited_ns is not None:
            waited_ns = now.waited_ns - before.waited_ns
        return ProcessorUsage(
            now.over_ns - before.over_ns, now.processor_ns - before.processor_ns, waited_ns
        )

    def _read(self) -> ProcessorUsage:
        """The counters, and the time since the machine started."""
        waited_ns = None
        if self._file is not None:
            with contextlib.suppress(OSError, ValueError, IndexError):
                waited_ns = int(os.pread(self._file, 128, 0).split()[1])
        return ProcessorUsage(time.monotonic_ns(), time.process_time_ns(), waited_ns)

    def close(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None


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


class _Timespec(ctypes.Structure):
    _fields_ = (("s", ctypes.c_long), ("ns", ctypes.c_long))


class _Semaphore:
    """A POSIX semaphore on which one thread waits until a time, not for one.

    Python's waits are relative: where another thread takes the processor as one begins, it ends
    so much later, often 1.5 ms. And up to Python 3.12 SimpleQueue.get(timeout=...) waits for ever
    where a signal's handler ends after its deadline.
    """

    def __init__(self) -> None:
        self._semaphore = (ctypes.c_long * 8)()
        self._end = _Timespec()
        self._waits = (self._semaphore, time.CLOCK_MONOTONIC, ctypes.byref(self._end))
        _LIBC.sem_init(self._semaphore, 0, 0)

    def post(self) -> None:
        _LIBC.sem_post(self._semaphore)

    def wait_until(self, end_ns: int) -> None:
        """Until a post, a signal or this time of the monotonic clock."""
        self._end.s, self._end.ns = divmod(end_ns, NS_PER_S)
        _LIBC.sem_clockwait(*self._waits)


_MUCH = 256
_AT_ONCE = 32


class WorkQueue:
    """A queue of work, safe to fill from any thread and from signal handlers."""

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], None]] = deque()
        self._wakeup = _Semaphore()

    def post(self, work: Callable[[], None]) -> None:
        """Queue work, run in the order of posting."""
        self._waiting.append(work)
        self._wakeup.post()

    def offer(self, work: Callable[[], None]) -> bool:
        """Queue work that may be refused; False where 256 items wait, and nothing is queued."""
        if len(self._waiting) >= _MUCH:
            return False
        self.post(work)
        return True

    def run_waiting(self) -> None:
        """Run what waits, at most 32 items: the tick that follows must not be late."""
        for _ in range(min(len(self._waiting), _AT_ONCE)):
            self._waiting.popleft()()

    def run_until(self, last_begin_ns: int, end_ns: int) -> None:
        """Run work as it comes in; return at `end_ns` of the monotonic clock.

        From `last_begin_ns` on none is begun.
        """
        while (now_ns := time.monotonic_ns()) < end_ns:
            if self._waiting and now_ns < last_begin_ns:
                self._waiting.popleft()()
            else:
                self._wakeup.wait_until(end_ns)
