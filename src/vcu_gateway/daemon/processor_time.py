"""Processor time up to a late tick: distinguishes a starved machine from a busy gateway."""

import contextlib
import os
import time
from typing import NamedTuple

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
