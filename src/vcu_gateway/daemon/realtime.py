"""Keeping the program's pages in memory, so that no tick waits for the disk."""

import ctypes
import os

from vcu_gateway.errors import Problem, UnavailableError

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4


def lock() -> None:
    """Lock what is and will be in memory; pages never touched cost nothing.

    Raises UnavailableError where the limit on locked memory does not allow it.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        what = f"memory cannot be locked: {os.strerror(ctypes.get_errno())}"
        remedy = "raise the limit (LimitMEMLOCK= of the service, ulimit -l)"
        raise UnavailableError(Problem(what, remedy=remedy))
