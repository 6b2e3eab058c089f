"""State of the disk: what went wrong, and when it is tried again."""

import errno
import os
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Literal

DiskState = Literal["ok", "full", "failing", "stalled"]

_NO_ROOM = (errno.ENOSPC, errno.EDQUOT)
_FIRST_PAUSE_S = 0.5
_LONGEST_PAUSE_S = 30.0
_STALLED_S = 2.0
_SYNC_TIMES_S = 60.0
_PROBE_BYTES = 64 << 10
_PROBE_NAME = ".probe"


_NOT_THE_DISK = (
    errno.ENAMETOOLONG,
    errno.EINVAL,
    errno.ENOTDIR,
    errno.EISDIR,
    errno.ELOOP,
    errno.EEXIST,
    errno.ENOTEMPTY,
    errno.EACCES,
)
"""What a name or a folder answers that is wrong: the disk takes everything else."""


def is_of_a_name(error: OSError) -> bool:
    """True where a name or a folder is at fault and the disk is not."""
    return error.errno in _NOT_THE_DISK


def is_full(error: OSError) -> bool:
    """True where there is no room: what could not be written may fit later."""
    return error.errno in _NO_ROOM


def probe(folder: Path) -> None:
    """Have a small file on the disk, and remove it; OSError where the disk does not take it."""
    path = folder / _PROBE_NAME
    try:
        with path.open("wb", buffering=0) as file:
            file.write(bytes(_PROBE_BYTES))
            os.fdatasync(file.fileno())
    finally:
        path.unlink(missing_ok=True)


class Disk:
    """Whether the disk takes what is written; told once for each change.

    The writer's thread calls `failed`, `worked`, `synced` and `busy`; another one `watch`, since a
    disk that stalls holds the writer up.

    Attributes:
        last_error: the latest, as text; None where there was none.
        last_sync_s: how long the latest fdatasync took; None before it.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self._say = say
        self._trouble: DiskState = "ok"
        self._since_s = self._retry_s = 0.0
        self._pause_s = _FIRST_PAUSE_S
        self._busy_since_s: float | None = None
        self._stall_told = False
        self.last_error: str | None = None
        self.last_sync_s: float | None = None
        self._sync_times: deque[tuple[float, float]] = deque()

    @property
    def state(self) -> DiskState:
        return "stalled" if self._is_stalled() else self._trouble

    @property
    def is_in_trouble(self) -> bool:
        """True from a failure until something was written again."""
        return self._trouble != "ok"

    @property
    def pause_s(self) -> float:
        """How long nothing is to be written; 0 where it may be."""
        return 0.0 if self._trouble == "ok" else max(0.0, self._retry_s - time.monotonic())

    def failed(self, error: OSError) -> None:
        """It did not take something: try again after a pause, a longer one each time."""
        now_s = time.monotonic()
        state: DiskState = "full" if is_full(error) else "failing"
        if self._trouble == "ok":
            self._since_s = now_s
        if self._trouble != state:
            self._say(f"the disk is {state}: {_text(error)}; what comes waits in memory")
        self._trouble, self.last_error = state, _text(error)
        self._retry_s = now_s + self._pause_s
        self._pause_s = min(_LONGEST_PAUSE_S, 2 * self._pause_s)

    def worked(self) -> None:
        if self._trouble != "ok":
            self._say(f"the disk works again, after {time.monotonic() - self._since_s:.1f} s")
        self._trouble, self._pause_s = "ok", _FIRST_PAUSE_S

    def synced(self, took_s: float) -> None:
        now_s, times = time.monotonic(), self._sync_times
        self.last_sync_s = took_s
        times.append((now_s, took_s))
        while times[0][0] < now_s - _SYNC_TIMES_S:
            times.popleft()

    @property
    def longest_sync_s(self) -> float | None:
        """The longest of the last minute before the latest; None before the first."""
        return max((took_s for _, took_s in list(self._sync_times)), default=None)

    def busy(self, is_busy: bool) -> None:
        self._busy_since_s = time.monotonic() if is_busy else None

    def _is_stalled(self) -> bool:
        since_s = self._busy_since_s
        return since_s is not None and time.monotonic() - since_s > _STALLED_S

    def watch(self) -> None:
        stalled = self._is_stalled()
        if stalled and not self._stall_told:
            self._say(
                f"the disk stalls for more than {_STALLED_S:.0f} s; what comes waits in memory"
            )
        if self._stall_told and not stalled:
            self._say("the disk stalls no longer")
        self._stall_told = stalled


def _text(error: OSError) -> str:
    where = f" ({error.filename})" if error.filename else ""
    return f"{error.strerror or error}{where}"
