"""Room on the disk: what went wrong with it, and the ring of segments that the oldest leave."""

import contextlib
import errno
import os
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

from vcu_gateway.recording import layout, signature

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


KEPT_WITHOUT_ROOM = 2
"""Ended segments that stay however full the disk is: the minute before an incident."""


class EndedSegment(NamedTuple):
    """A segment that is not written any more."""

    folder: Path
    number: int
    size: int


class Ring:
    """Ended segments of all drives, oldest first; belongs to the writer's thread.

    Drives are in the order of their numbers, whatever the clock said when they were made.

    Attributes:
        size: bytes of all ended segments, without those of drives that somebody keeps.
        removed: segments removed by this process.
        next_drive: number of the next new drive.
    """

    def __init__(self, drives: Path) -> None:
        """Find the segments that are there; OSError where the folder cannot be read."""
        self._segments: deque[EndedSegment] = deque()
        self.size = self.removed = 0
        self.next_drive = 1
        found = sorted((_number(folder), folder) for folder in layout.recorded_folders(drives))
        for number, folder in found:
            self.next_drive = max(self.next_drive, number + 1)
            for segment in layout.segments(folder):
                self.ended(folder, segment.number)

    def ended(self, folder: Path, number: int) -> None:
        """A segment has ended: it may be removed from now on."""
        size = sum(map(_size, _paths(folder, number)))
        self._segments.append(EndedSegment(folder, number, size))
        self.size += size

    def before(self, folder: Path, since_wall_s: float) -> list[Path]:
        """Files of ended segments of this drive written since then, its last one in any case."""
        paths = [_paths(folder, one.number) for one in self._segments if one.folder == folder]
        return [
            path
            for index, files in enumerate(paths)
            for path in files
            if index == len(paths) - 1 or _written_since(path, since_wall_s)
        ]

    def last_drive(self, channel: str, besides: Path) -> Path | None:
        """Folder of the last drive of this channel that ended segments are left of."""
        folders = dict.fromkeys(one.folder for one in reversed(self._segments))
        return next((one for one in folders if one != besides and _channel(one) == channel), None)

    def make_room(self, wanted_bytes: int, keep: int = 0) -> bool:
        """Remove the oldest until that many bytes went; False where fewer could.

        The `keep` newest ended segments stay in any case.
        """
        went = 0
        while went < wanted_bytes and len(self._segments) > keep:
            went += self._remove_oldest()
        return went >= wanted_bytes

    def _remove_oldest(self) -> int:
        """Bytes that went; 0 where somebody keeps the drive, which is not counted any more."""
        oldest = self._segments.popleft()
        self.size -= oldest.size
        if os.path.lexists(oldest.folder / layout.KEEP_FILE):
            return 0
        for path in _paths(oldest.folder, oldest.number):
            with contextlib.suppress(FileNotFoundError):
                path.unlink()
        self.removed += 1
        if not any(one.folder == oldest.folder for one in self._segments):
            _remove_empty_drive(oldest.folder)
        return oldest.size


def room_bytes(folder: Path) -> tuple[int, int]:
    """Size of the file system, and how much of it a service may still use."""
    found = os.statvfs(folder)
    return found.f_blocks * found.f_frsize, found.f_bavail * found.f_frsize


def _paths(folder: Path, number: int) -> tuple[Path, ...]:
    """Its files; those of its signature are not always there."""
    names = (layout.frames_name(number), layout.core_name(number))
    return (*(folder / name for name in names), *signature.link_paths(folder, number))


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except FileNotFoundError:
        return 0


def _written_since(path: Path, wall_s: float) -> bool:
    try:
        return path.stat().st_mtime >= wall_s
    except OSError:
        return False


def _remove_empty_drive(folder: Path) -> None:
    with contextlib.suppress(OSError):
        if layout.segments(folder):
            return
        for name in layout.FILES_BESIDE:
            (folder / name).unlink(missing_ok=True)
        folder.rmdir()


def _number(folder: Path) -> int:
    """Number of a drive; 0, the oldest, where it cannot be read."""
    number = layout.description_if_any(folder / layout.DRIVE_FILE).get("number")
    return number if isinstance(number, int) else 0


def _channel(folder: Path) -> object:
    return layout.description_if_any(folder / layout.DRIVE_FILE).get("channel")
