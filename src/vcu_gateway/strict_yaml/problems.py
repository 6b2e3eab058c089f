"""Problems of a file, with file, line and key, for the person who wrote it."""

import json
import math
from collections.abc import Iterable
from typing import Any, NamedTuple

from vcu_gateway.errors import Problem
from vcu_gateway.strict_yaml.lines import LineMap, Path

_SHOWN_CHARACTERS = 40


class FileProblem(NamedTuple):
    """Problem of the key at `path`; `line` where another than the path's is meant."""

    path: Path
    what: str
    remedy: str = ""
    line: int | None = None


def problems(
    findings: Iterable[FileProblem], file: str, lines: LineMap, hexadecimal: Path | None = None
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


def dotted(path: Path, hexadecimal: Path | None = None) -> str:
    return ".".join(
        _shown_key(key, as_hexadecimal=path[:depth] == hexadecimal)
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
