"""Ring of segments: the oldest go where all together are too large, or the disk nearly full."""

import contextlib
import os
from collections import deque
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.recording import layout, signature

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
        own = [one for one in self._segments if one.folder == folder]
        paths = [_paths(folder, one.number) for one in own]
        return [
            path
            for index, files in enumerate(paths)
            for path in files
            if index == len(paths) - 1 or _written_since(path, since_wall_s)
        ]

    def last_drive(self, channel: str, besides: Path) -> Path | None:
        """Folder of the last drive of this channel that ended segments are left of."""
        folders = dict.fromkeys(one.folder for one in reversed(self._segments))
        return next(
            (one for one in folders if one != besides and _channel(one) == channel),
            None,
        )

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
