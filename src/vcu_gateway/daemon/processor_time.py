"""Processor time between two ticks: distinguishes a starved machine from a busy gateway."""

import contextlib
import os
import time
from typing import NamedTuple

_SCHEDSTAT = "/proc/thread-self/schedstat"
_BYTES = 128


class ProcessorUsage(NamedTuple):
    """Processor time of one interval.

    Attributes:
        processor_ns: processor time of the whole process.
        waited_ns: how long the asking thread was ready to run and had no processor; None where
            the kernel does not count it.
    """

    processor_ns: int
    waited_ns: int | None


class ProcessorTime:
    """Counter of one thread and its process, read by that thread; it keeps one file open."""

    def __init__(self) -> None:
        self._file: int | None = None
        with contextlib.suppress(OSError):
            self._file = os.open(_SCHEDSTAT, os.O_RDONLY | os.O_CLOEXEC)
        self._processor_ns = time.process_time_ns()
        self._waited_ns = self._waited()

    def since_last(self) -> ProcessorUsage:
        """Processor time since the last call, or since the beginning."""
        processor_ns, waited_ns = time.process_time_ns(), self._waited()
        spent_ns, before_ns = processor_ns - self._processor_ns, self._waited_ns
        self._processor_ns, self._waited_ns = processor_ns, waited_ns
        if waited_ns is None or before_ns is None:
            return ProcessorUsage(spent_ns, None)
        return ProcessorUsage(spent_ns, waited_ns - before_ns)

    def _waited(self) -> int | None:
        """The second number: time on the run queue."""
        if self._file is None:
            return None
        with contextlib.suppress(OSError, ValueError, IndexError):
            return int(os.pread(self._file, _BYTES, 0).split()[1])
        return None

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            os.close(self._file)
            self._file = None
