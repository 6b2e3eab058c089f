"""Recordings by name: a path as it is, or a drive or an incident where the recorder keeps them."""

import errno
import stat
from pathlib import Path

from vcu_gateway.drive_format import layout
from vcu_gateway.drive_format.layout import DEFAULT_FOLDER
from vcu_gateway.recordings.folder import read_error

_NOT_THERE = (errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG, errno.EINVAL)


def recording_path(name: str) -> Path:
    """The path of this name; below DEFAULT_FOLDER where nothing of this name lies here.

    NotPermittedError where this user may not look.
    """
    path = Path(name)
    if "/" in name or "." in name or _is_there(path):  # the recorder's names have neither
        return path
    for part in (layout.DRIVES, layout.INCIDENTS):
        kept = DEFAULT_FOLDER / part / name
        if _is_there(kept):
            return kept
    return path


def recorded_path(name: str) -> Path | None:
    """The drive, incident or segment of this name; None where it is something else, such as a log.

    NotPermittedError where this user may not look.
    """
    path = recording_path(name)
    if _is_there(path, folder=True):
        return path
    beside = path.parent / layout.DRIVE_FILE
    if layout.segment_number(path.name) is not None and _is_there(beside):
        return path
    return None


def _is_there(path: Path, folder: bool = False) -> bool:
    try:
        found = path.stat()
    except ValueError:  # a null character
        return False
    except OSError as error:
        if error.errno in _NOT_THERE:
            return False
        raise read_error(error, path) from error
    return not folder or stat.S_ISDIR(found.st_mode)
