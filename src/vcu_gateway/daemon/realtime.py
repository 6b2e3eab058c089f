"""Processor of the ticking thread: locked memory, its switches, and the time up to a late tick."""

import contextlib
import ctypes
import gc
import os
import sys
import time
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.errors import Problem, UnavailableError

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_SWITCH_INTERVAL_S = 0.0005
_COLLECT_EVERY_TICKS = 1200


def lock_memory() -> None:
    """Lock every page in memory (mlockall), so that no tick waits for the disk.

    Pages that are never touched cost nothing.

    Raises UnavailableError where the limit on locked memory does not allow it.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
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
_BYTES = 128


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
        return ProcessorUsage(time.monotonic_ns(), time.process_time_ns(), self._waited())

    def _waited(self) -> int | None:
        if self._file is None:
            return None
        with contextlib.suppress(OSError, ValueError, IndexError):
            return int(os.pread(self._file, _BYTES, 0).split()[1])
        return None

    def close(self) -> None:
        if self._file is not None:
            os.close(self._file)
            self._file = None
