"""Small files of one boot, that the next process of the gateway reads."""

import os
from pathlib import Path

_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC

HIDDEN = "-"
"""In place of a boot's number that cannot be read."""


def boot_id() -> str:
    """The boot's number, or a dash where it is hidden: /run does not outlive a boot anyway."""
    try:
        return _BOOT_ID.read_text(encoding="ascii").strip() or HIDDEN
    except OSError:
        return HIDDEN


def write_whole(path: Path, text: str) -> None:
    """Replace the file in one piece: whoever reads it, after a kill too, has the old or the new.

    Raises OSError, and the old one stays. Nothing is written through a link that lies in the way.
    """
    beside = path.with_name(f"{path.name}.new")
    with open(os.open(beside, _NEW_FILE, 0o644), "w", encoding="utf-8") as file:
        file.write(text)
    os.replace(beside, path)
