"""Processor time that is left over, for kernels that count it in whole ticks.

A program that counts at SCHED_IDLE runs only while nothing else wants its processor. How much
slower it counts than alone is how busy the processor is, with whatever.
"""

import mmap
import subprocess
import tempfile
import time
from types import TracebackType
from typing import Self

from bench import under_test

_ALONE_S = 0.5


class Spare:
    """The counting program on the processor of the program under test, while it is entered."""

    def __init__(self) -> None:
        self._file = tempfile.NamedTemporaryFile()  # noqa: SIM115 - closed at the exit
        self._file.truncate(mmap.PAGESIZE)
        self._memory = mmap.mmap(self._file.fileno(), mmap.PAGESIZE)

    def __enter__(self) -> Self:
        with under_test.on_its_processor():
            self._child = subprocess.Popen([under_test.compiled("spare.c"), self._file.name])
        while not self._count():
            time.sleep(0.01)
        before, begun_s = self._count(), time.monotonic()
        time.sleep(_ALONE_S)
        self._alone_per_s = (self._count() - before) / (time.monotonic() - begun_s)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._child.kill()
        self._child.wait()
        self._memory.close()
        self._file.close()

    def taken_ns(self) -> int:
        """Time so far in which the processor did something else."""
        return time.monotonic_ns() - int(self._count() / self._alone_per_s * 1e9)

    def _count(self) -> int:
        return int.from_bytes(self._memory[:8], "little")
