"""Text of a file that people write: UTF-8, at most 1 MiB, a regular file."""

import codecs
import errno
import stat
from pathlib import Path

from vcu_gateway.errors import ConfigError, GatewayError, MissingInputError, Problem

_LARGEST_BYTES = 1 << 20
_BYTE_ORDER_MARK = "\ufeff"

_UNREADABLE = {
    errno.ENOENT: "there is no such file",
    errno.ENOTDIR: "there is no such file",
    errno.EISDIR: "is a directory, not a file",
    errno.ELOOP: "is a symbolic link that leads back to itself",
    errno.EACCES: "this user may not read it",
    errno.EPERM: "this user may not read it",
}


def read(path: Path, error: type[GatewayError] = ConfigError) -> str:
    """The whole text, without a byte order mark.

    Raises MissingInputError where there is no file that this user can read, and `error` where its
    contents are no text, or too much.
    """
    contents = _contents(path)
    where = str(path)
    if len(contents) > _LARGEST_BYTES:
        raise error(Problem("is larger than 1 MiB", where))
    if contents.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise error(Problem("is UTF-16 text", where, "save it as UTF-8"))
    if b"\0" in contents:
        raise error(Problem("is binary, not text", where))
    try:
        return contents.decode().removeprefix(_BYTE_ORDER_MARK)
    except UnicodeDecodeError as no_text:
        line = contents.count(b"\n", 0, no_text.start) + 1
        what = f"is not UTF-8 text: byte 0x{contents[no_text.start]:02X}"
        raise error(Problem(what, f"{where}:{line}", "save it as UTF-8")) from no_text


def _contents(path: Path) -> bytes:
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, "")
        if not stat.S_ISREG(mode):
            raise MissingInputError(Problem("is no regular file", str(path)))
        with path.open("rb") as file:
            return file.read(_LARGEST_BYTES + 1)
    except (OSError, ValueError) as error:
        raise MissingInputError(Problem(_why_unreadable(error), str(path))) from error


def _why_unreadable(error: OSError | ValueError) -> str:
    if isinstance(error, OSError) and error.errno in _UNREADABLE:
        return _UNREADABLE[error.errno]
    return f"cannot be read: {error}"
