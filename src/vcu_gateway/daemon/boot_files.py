"""Small files of one boot, written whole, for the next process of the gateway."""

import os
from pathlib import Path

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC

HIDDEN = "-"
"""Stands for a boot identifier that cannot be read."""


def boot_id() -> str:
    """Boot identifier of the kernel; `HIDDEN` where it cannot be read: /run ends with the boot."""
    try:
        return _BOOT_ID.read_text(encoding="ascii").strip() or HIDDEN
    except OSError:
        return HIDDEN


def write_whole(path: Path, text: str) -> None:
    """Replace a file atomically: a reader has the old contents or the new, after a kill too.

    Raises OSError, and the old one stays. Nothing is written through a link that lies in the way.
    """
    beside = path.with_name(f"{path.name}.new")
    with os.fdopen(os.open(beside, _NEW_FILE, 0o644), "w", encoding="utf-8") as file:
        file.write(text)
    beside.replace(path)
