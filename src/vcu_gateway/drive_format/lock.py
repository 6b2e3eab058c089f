"""Mark of a drive's folder that is being written; it ends with the process, however that ends."""

import fcntl
import os
from pathlib import Path

FOLDER_FLAGS = os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC


def hold(folder: Path) -> int:
    """Mark it as being written; the descriptor that is to be closed in the end."""
    descriptor = os.open(folder, FOLDER_FLAGS)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    return descriptor


def is_held(folder: Path) -> bool:
    """True where a process writes into it; OSError where the folder cannot be opened."""
    descriptor = os.open(folder, FOLDER_FLAGS)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(descriptor)
    return False
