"""Real-time settings of the process: locked memory, garbage collection, switch interval."""

import contextlib
import ctypes
import gc
import os
import sys
from collections.abc import Iterator

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
