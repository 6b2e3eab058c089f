"""The verb as somebody runs it."""

import gzip
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from click.testing import CliRunner

from vcu_gateway import cli
from vcu_gateway.errors import GatewayError


class Ran(NamedTuple):
    code: int
    out: str
    err: str

    @property
    def values(self) -> dict[str, Any]:
        values: dict[str, Any] = json.loads(self.out)
        return values


def replay(*arguments: str | Path) -> Ran:
    result = CliRunner().invoke(cli.group, ["replay", *map(str, arguments)])
    if isinstance(result.exception, GatewayError):
        told = "".join(f"error: {problem}\n" for problem in result.exception.problems)
        return Ran(result.exception.exit_code, result.stdout, result.stderr + told)
    if result.exception and not isinstance(result.exception, SystemExit):
        raise result.exception
    return Ran(result.exit_code, result.stdout, result.stderr)


def what_if(drive: Path, *assignments: str) -> dict[str, Any]:
    """What differs with these keys."""
    sets = [part for one in assignments for part in ("--set", one)]
    ran = replay(drive, "--json", *sets)
    assert ran.code in (0, 1), ran.err
    found: dict[str, Any] = ran.values["what_if"]
    assert ran.code == (not found["same"])
    return found


def rewrite(path: Path, change: Callable[[list[str]], list[str]]) -> None:
    """Change the lines of a file of a drive."""
    lines = gzip.decompress(path.read_bytes()).decode().splitlines()
    path.write_bytes(gzip.compress("".join(f"{line}\n" for line in change(lines)).encode()))


def changed(needle: str, change: Callable[[dict[str, Any]], None], which: int = 0):
    """A change of the n-th core line with this key."""

    def lines_of(lines: list[str]) -> list[str]:
        places = [n for n, line in enumerate(lines) if f'"{needle}":' in line]
        values = json.loads(lines[places[which]])
        change(values)
        lines[places[which]] = json.dumps(values)
        return lines

    return lines_of
