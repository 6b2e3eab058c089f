"""Generated files of the source tree: compared with what they should hold, or written."""

import contextlib
import difflib
import os
import tempfile
from collections.abc import Mapping
from itertools import islice
from pathlib import Path

import click

from vcu_gateway.errors import MissingInputError, Problem, UnavailableError

_SHOWN_LINES = 20


def check(generated: Mapping[Path, str], source: str, how_to_fix: str) -> None:
    """Exit with 1 where a file is not its generated text, after showing the first differences.

    `source` is what the files are made from, `how_to_fix` the command line that makes them.
    """
    stale = {path: text for path, text in generated.items() if current(path) != text}
    for path, text in stale.items():
        _report(path, text, source, how_to_fix)
    if stale:
        raise SystemExit(1)


def current(path: Path) -> str | None:
    """The file's text; None where there is none, or none that could be ours."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return file.read()
    except (FileNotFoundError, UnicodeDecodeError):
        return None
    except OSError as error:
        problem = Problem(f"cannot be read: {error.strerror or error}", str(path))
        raise MissingInputError(problem) from error


def _report(path: Path, text: str, source: str, how_to_fix: str) -> None:
    there = current(path)
    what = "is missing" if there is None else f"is not what {source} says"
    click.echo(f"{path} {what}: run `{how_to_fix}`", err=True)
    difference = difflib.unified_diff(
        (there or "").splitlines(),
        text.splitlines(),
        f"{path} as it is",
        "generated",
        lineterm="",
    )
    for line in islice(difference, _SHOWN_LINES):
        click.echo(f"  {line}", err=True)


def replace(path: Path, text: str) -> None:
    """Write the whole file or nothing, also through a symbolic link."""
    target = path.resolve()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        mode = target.stat().st_mode & 0o777 if target.exists() else 0o644
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
        beside = Path(name)
        try:
            with os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
                file.write(text)
            beside.chmod(mode)
            beside.replace(target)
        except BaseException:
            with contextlib.suppress(FileNotFoundError):
                beside.unlink()
            raise
    except OSError as error:
        problem = Problem(f"cannot be written: {error.strerror or error}", str(path))
        raise UnavailableError(problem) from error
