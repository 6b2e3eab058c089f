"""What is wrong with a configuration, in words for the person who wrote it."""

import json
import math
from collections.abc import Iterable
from typing import Any, NamedTuple

from vcu_gateway.errors import Problem
from vcu_gateway.strict_yaml.lines import LineMap, Path

_SHOWN_CHARACTERS = 40
_ALIASES = ("protocol", "aliases")


class FileProblem(NamedTuple):
    """One thing that is wrong with the key at `path`; `line` where the path's is not meant."""

    path: Path
    what: str
    remedy: str = ""
    line: int | None = None


def problems(findings: Iterable[FileProblem], file: str, lines: LineMap) -> list[Problem]:
    """The findings with file and line, in the order of the file."""
    placed = [(finding.line or lines.line(finding.path), finding) for finding in findings]
    placed.sort(key=lambda item: item[0] or 0)
    return [
        Problem(
            f"{dotted(finding.path)}: {finding.what}" if finding.path else finding.what,
            file if line is None else f"{file}:{line}",
            finding.remedy,
        )
        for line, finding in placed
    ]


def dotted(path: Path) -> str:
    """A key's full name; identifiers as they are written, in hexadecimal."""
    return ".".join(shown_key(path[:-1][:depth], key) for depth, key in enumerate(path))


def shown_key(parent: Path, key: str | int) -> str:
    """A key on one line."""
    if isinstance(key, int):
        return f"0x{key:08X}" if parent == _ALIASES and key >= 0 else str(key)
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
