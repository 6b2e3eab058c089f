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
    try:
        return _text(_contents(path), str(path))
    except _NoTextError as no_text:
        raise error(no_text.problem) from no_text


class _NoTextError(Exception):
    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self.problem = problem


def _contents(path: Path) -> bytes:
    try:
        mode = path.stat().st_mode
        if stat.S_ISDIR(mode):
            raise IsADirectoryError(errno.EISDIR, "")
        if not stat.S_ISREG(mode):
            raise MissingInputError(Problem("is no regular file", str(path)))
        with path.open("rb") as file:
            contents = file.read(_LARGEST_BYTES + 1)
    except (OSError, ValueError) as error:
        raise MissingInputError(Problem(_why_unreadable(error), str(path))) from error
    if len(contents) > _LARGEST_BYTES:
        raise _NoTextError(Problem("is larger than 1 MiB", str(path)))
    return contents


def _why_unreadable(error: OSError | ValueError) -> str:
    if isinstance(error, OSError) and error.errno in _UNREADABLE:
        return _UNREADABLE[error.errno]
    return f"cannot be read: {error}"


def _text(contents: bytes, where: str) -> str:
    if contents.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise _NoTextError(Problem("is UTF-16 text", where, "save it as UTF-8"))
    if b"\0" in contents:
        raise _NoTextError(Problem("is binary, not text", where))
    try:
        return contents.decode().removeprefix(_BYTE_ORDER_MARK)
    except UnicodeDecodeError as error:
        line = contents.count(b"\n", 0, error.start) + 1
        what = f"is not UTF-8 text: byte 0x{contents[error.start]:02X}"
        raise _NoTextError(Problem(what, f"{where}:{line}", "save it as UTF-8")) from error
