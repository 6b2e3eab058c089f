"""Resources of this process: processor time, memory, open files."""

import contextlib
import os
import re
import time
from pathlib import Path

from vcu_gateway.api import results

_PROC = Path("/proc/self")
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
_OPEN_FILES = re.compile(r"^Max open files +([0-9]+) ", re.MULTILINE)


def process_usage() -> results.ProcessUsage:
    """Usage now; None where /proc has no such figure."""
    virtual_bytes, resident_bytes = _memory_bytes()
    return {
        "cpu_time_s": time.process_time(),
        "resident_memory_bytes": resident_bytes,
        "virtual_memory_bytes": virtual_bytes,
        "open_fds": _open_fds(),
        "max_fds": _max_fds(),
    }


def _memory_bytes() -> tuple[int | None, int | None]:
    """Virtual and resident memory."""
    with contextlib.suppress(OSError, ValueError):
        virtual_pages, resident_pages, *_ = (_PROC / "statm").read_text().split()
        return int(virtual_pages) * _PAGE_BYTES, int(resident_pages) * _PAGE_BYTES
    return None, None


def _open_fds() -> int | None:
    with contextlib.suppress(OSError):
        return len(os.listdir(_PROC / "fd"))
    return None


def _max_fds() -> int | None:
    """The soft limit; None where there is none."""
    with contextlib.suppress(OSError):
        found = _OPEN_FILES.search((_PROC / "limits").read_text())
        return int(found[1]) if found else None
    return None
