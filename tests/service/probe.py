"""What a process in the service's sandbox can do; run by the service itself: probe.py RESULT."""

import functools
import json
import mmap
import os
import socket
import sys
from collections.abc import Callable
from pathlib import Path

FOLDERS = ("/", "/etc", "/etc/vcu-gateway", "/usr", "/home", "/root", "/proc", "/sys", "/dev")
OWN = ("/run/vcu-gateway", "/var/lib/vcu-gateway", "/tmp")


def refused(do: Callable[[], object]) -> str | None:
    """The error's name, None where it could be done."""
    try:
        do()
    except OSError as error:
        return os.strerror(error.errno or 0)
    return None


def write(folder: str) -> None:
    path = Path(folder) / "probe"
    path.write_text("written")
    path.unlink()


def run_written_memory() -> None:
    mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)


def priority() -> None:
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(90))


probed = {
    "uid": os.getuid(),
    "writes": {folder: refused(functools.partial(write, folder)) for folder in FOLDERS + OWN},
    "sees": {folder: sorted(os.listdir(folder)) for folder in ("/", "/dev", "/etc/vcu-gateway")},
    "processes": sum(name.isdigit() for name in os.listdir("/proc")),
    "AF_INET": refused(socket.socket),
    "AF_CAN": refused(lambda: socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)),
    "memory that is written and run": refused(run_written_memory),
    "a higher priority": refused(priority),
    "a file of another owner": refused(lambda: os.chown(OWN[1], 0, 0)),
}
Path(sys.argv[1]).write_text(json.dumps(probed))
