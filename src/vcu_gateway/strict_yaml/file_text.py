"""Files that people write: their text, the line of each key, and problems that name it."""

import codecs
import errno
import json
import math
import stat
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.errors import ConfigError, GatewayError, MissingInputError, Problem

KeyPath = tuple[str | int, ...]


class PointIndex(int):
    """Index of a point in a curve; a problem shows it as [2], counted from 1."""


class LineMap(dict[KeyPath, int]):
    """Line of each key and item, by its path in the document."""

    def line(self, path: Sequence[str | int]) -> int | None:
        """The line of the longest known beginning of this path, or None."""
        known = tuple(path)
        while known and known not in self:
            known = known[:-1]
        return self.get(known)

    def where(self, file: str, path: Sequence[str | int]) -> str:
        """file:line, or the file alone where the line is not known."""
        line = self.line(path)
        return file if line is None else f"{file}:{line}"


_SHOWN_CHARACTERS = 40


class FileProblem(NamedTuple):
    """Problem of the key at `path`; `line` where another than the path's is meant."""

    path: KeyPath
    what: str
    remedy: str = ""
    line: int | None = None


def problems(
    findings: Iterable[FileProblem], file: str, lines: LineMap, hexadecimal: KeyPath | None = None
) -> list[Problem]:
    """The findings with file and line, in the order of the file.

    The keys of the mapping at `hexadecimal` are shown as identifiers, 0x and 8 digits.
    """
    placed = [(finding.line or lines.line(finding.path), finding) for finding in findings]
    placed.sort(key=lambda item: item[0] or 0)
    return [
        Problem(
            f"{dotted(finding.path, hexadecimal)}: {finding.what}"
            if finding.path
            else finding.what,
            file if line is None else f"{file}:{line}",
            finding.remedy,
        )
        for line, finding in placed
    ]


def dotted(path: KeyPath, hexadecimal: KeyPath | None = None) -> str:
    return "".join(
        f"[{key + 1}]"
        if isinstance(key, PointIndex)
        else "." * (depth > 0) + _shown_key(key, as_hexadecimal=path[:depth] == hexadecimal)
        for depth, key in enumerate(path)
    )


def _shown_key(key: str | int, *, as_hexadecimal: bool) -> str:
    if isinstance(key, int):
        return f"0x{key:08X}" if as_hexadecimal and key >= 0 else str(key)
    return _shortened(key)


def shown(value: Any) -> str:
    """A value on one line, as it stands in YAML."""
    if value is None:
        return "empty"
    if isinstance(value, dict | list):
        return "a mapping" if isinstance(value, dict) else "a list"
    if isinstance(value, float) and not math.isfinite(value):
        return str(value).replace("inf", ".inf").replace("nan", ".nan")
    return json.dumps(_shortened(value) if isinstance(value, str) else value, ensure_ascii=False)


def _shortened(text: str) -> str:
    return text if len(text) <= _SHOWN_CHARACTERS else text[: _SHOWN_CHARACTERS - 1] + "…"


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
