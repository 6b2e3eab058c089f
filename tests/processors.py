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
