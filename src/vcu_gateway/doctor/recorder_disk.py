"""Disk that the recordings are on: file system, device, what it has been through."""

import os
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.doctor.procfs import Unreadable, text, unreadable

_MOUNTS = "/proc/self/mountinfo"
_BLOCK_DEVICES = "/sys/dev/block"
_SECTOR_BYTES = 512


class RecordingDisk(NamedTuple):
    """Facts about it.

    Attributes:
        file_system: such as ext4 or tmpfs.
        is_read_only: nothing can be written.
        total_bytes, free_bytes: free for others than root.
        card: "SD" or "MMC" for a card or an eMMC; empty for other devices.
        card_bytes: size of the whole card; 0 where it is none.
        worn_pct: share of its life that an eMMC says it has used, in steps of 10; None where it
            does not say.
    """

    file_system: str
    is_read_only: bool
    total_bytes: int
    free_bytes: int
    card: str = ""
    card_bytes: int = 0
    worn_pct: int | None = None


def read(folder: Path) -> RecordingDisk | Unreadable | None:
    try:
        found, device = os.statvfs(folder), folder.stat().st_dev
    except FileNotFoundError:
        return None
    except OSError as error:
        return unreadable(str(folder), error)
    disk = RecordingDisk(
        _file_system(device),
        bool(found.f_flag & os.ST_RDONLY),
        found.f_blocks * found.f_frsize,
        found.f_bavail * found.f_frsize,
    )
    return _with_card(disk, Path(_BLOCK_DEVICES, f"{os.major(device)}:{os.minor(device)}"))


def _file_system(device: int) -> str:
    """Type of the file system on this device; empty where it is not mounted here."""
    mounts = text(_MOUNTS)
    number = f"{os.major(device)}:{os.minor(device)}"
    lines = [] if isinstance(mounts, Unreadable) else mounts.splitlines()
    for line in lines:
        own, _, of_file_system = line.partition(" - ")
        if own.split()[2:3] == [number]:
            return of_file_system.split()[0]
    return ""


def _with_card(disk: RecordingDisk, block: Path) -> RecordingDisk:
    """With what a card's driver tells; a partition's disk is the folder above it."""
    whole = block.resolve()
    if (whole / "partition").exists():
        whole = whole.parent
    kind, sectors = text(str(whole / "device/type")), text(str(whole / "size"))
    if kind not in ("SD", "MMC") or not isinstance(sectors, str) or not sectors.isdecimal():
        return disk
    return disk._replace(
        card=kind,
        card_bytes=int(sectors) * _SECTOR_BYTES,
        worn_pct=worn_pct(text(str(whole / "device/life_time"))),
    )


def worn_pct(told: str | Unreadable) -> int | None:
    """The larger estimate of an eMMC, such as of `0x01 0x02`; None for 0, which says nothing."""
    words = told.split() if isinstance(told, str) else []
    try:
        steps = max((int(word, 16) for word in words), default=0)
    except ValueError:
        return None
    return 10 * steps if steps else None
