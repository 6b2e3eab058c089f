"""Files that are replaced as a whole, and what has to be on the disk."""

import contextlib
import os
from pathlib import Path

_NEW_FILE = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC


def replace(path: Path, contents: str | bytes, mode: int | None = None) -> None:
    """Replace a file atomically: a reader has the old contents or the new, after a kill too.

    `mode` is the new file's, whatever the umask; None: 0o644 without the umask's bits. Text is
    written as UTF-8. Raises OSError, and the old file stays. Nothing is written through a link
    that lies in the way, as `path.new`. After a power cut either may be there (`sync`).
    """
    beside = path.with_name(f"{path.name}.new")
    descriptor = os.open(beside, _NEW_FILE, 0o644 if mode is None else mode)
    try:
        with os.fdopen(descriptor, "wb") as file:
            if mode is not None:
                os.fchmod(descriptor, mode)
            file.write(contents.encode() if isinstance(contents, str) else contents)
        beside.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            beside.unlink()
        raise


def sync(path: Path) -> None:
    """Have a file, or a folder's entries, on the disk; OSError where that fails."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
