"""Processors that programs are started on."""

import contextlib
import os
from collections.abc import Iterator


@contextlib.contextmanager
def started_on(processors: set[int]) -> Iterator[None]:
    """Programs started in the block run on these processors only."""
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, processors)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextlib.contextmanager
def held_on(pid: int, processor: int) -> Iterator[None]:
    """That program's threads run on this processor only."""
    before = os.sched_getaffinity(pid)
    _hold(pid, {processor})
    try:
        yield
    finally:
        _hold(pid, before)


def _hold(pid: int, processors: set[int]) -> None:
    for thread in os.listdir(f"/proc/{pid}/task"):
        with contextlib.suppress(ProcessLookupError):  # it has ended
            os.sched_setaffinity(int(thread), processors)
