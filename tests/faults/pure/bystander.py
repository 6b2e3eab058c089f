"""What the machine does to a process that ticks as the gateway does, and a measurement taken twice.

python -m tests.faults.pure.bystander FILE HOGS
"""

import contextlib
import mmap
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

from tests.driven import wait_until
from tests.faults.conftest import ROOT

PERIOD_NS = 50_000_000
PATIENCE_S = 60.0
READ_EVERY_S, READ_FOR_S = 0.017, 0.0005
_counts = struct.Struct("=QQ")
Found = TypeVar("Found")


class Bystander:
    """A process that ticks every 50 ms, no busier than a gateway, and knows nothing of one."""

    def __init__(self, memory: mmap.mmap) -> None:
        self._memory = memory
        self._before = 0

    def begin(self) -> None:
        """Count from now on."""
        self._before = _counts.unpack_from(self._memory)[0]

    @property
    def missed(self) -> int:
        """Points that a scheduler with the gateway's rule would have missed since `begin`."""
        missed: int = _counts.unpack_from(self._memory)[0] - self._before
        return missed


@contextlib.contextmanager
def bystander(folder: Path, hogs: int = 0) -> Iterator[Bystander]:
    """It runs while the block lasts, with so many threads of its own that never yield."""
    path = folder / "bystander"
    path.write_bytes(bytes(_counts.size))
    module = [sys.executable, "-m", "tests.faults.pure.bystander", str(path), str(hogs)]
    process = subprocess.Popen(module, cwd=ROOT)
    try:
        with path.open("r+b") as file, mmap.mmap(file.fileno(), _counts.size) as memory:
            wait_until(lambda: _counts.unpack_from(memory)[1] > 0, "the bystander", PATIENCE_S)
            yield Bystander(memory)
    finally:
        process.kill()
        process.wait()


def once_more(measure: Callable[[], Found], is_good: Callable[[Found], bool]) -> list[Found]:
    """One measurement; one that is not good is taken once more, and both are told."""
    found = [measure()]
    if not is_good(found[0]):
        found.append(measure())
    assert is_good(found[-1]), found
    return found


def _hog() -> None:
    while True:
        sum(range(1000))


def _read() -> None:
    """As a thread that reads frames does: it computes a little, again and again."""
    while True:
        end_s = time.monotonic() + READ_FOR_S
        while time.monotonic() < end_s:
            pass
        time.sleep(READ_EVERY_S)


def _beat(path: Path, hogs: int) -> None:
    sys.setswitchinterval(0.0005)
    for work in [_read] + [_hog] * hogs:
        threading.Thread(target=work, daemon=True).start()
    missed = ticks = 0
    due_ns = time.monotonic_ns()
    with path.open("r+b") as file, mmap.mmap(file.fileno(), _counts.size) as memory:
        while True:
            time.sleep(max(0, due_ns - time.monotonic_ns()) / 1e9)
            late = (time.monotonic_ns() - due_ns + PERIOD_NS // 2) // PERIOD_NS
            missed, ticks = missed + late, ticks + 1
            _counts.pack_into(memory, 0, missed, ticks)
            due_ns += PERIOD_NS * (1 + late)


if __name__ == "__main__":
    _beat(Path(sys.argv[1]), int(sys.argv[2]))
