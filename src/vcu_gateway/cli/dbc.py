"""`vcu-gateway dbc`: the DBC and the protocol page, from the definition."""

import contextlib
import difflib
import os
import shlex
import tempfile
from itertools import islice
from pathlib import Path

import click

from vcu_gateway.errors import MissingInputError, Problem, UnavailableError
from vcu_gateway.protocol import dbc, definition, docs_page

_DEFINITION = Path("dbc/vcu.yaml")
_OUTPUT = Path("dbc/vcu.dbc")
_PAGE = Path("docs/protocol.md")
_SHOWN_LINES = 20

_HELP = """Generate the DBC and the protocol page from the definition.

The files are those of the source tree in the current directory, unless they are named. With
--check nothing is written: the exit code is 1 where a file is not what the definition says, and
the first differing lines are shown.
"""

_FILE = click.Path(dir_okay=False, path_type=Path)


@click.command("dbc", help=_HELP)
@click.option("--check", is_flag=True, help="Write nothing; exit 1 where a file is stale.")
@click.option(
    "--definition",
    "source",
    metavar="FILE",
    type=_FILE,
    default=_DEFINITION,
    show_default=True,
    help="The protocol, written once.",
)
@click.option(
    "--output", metavar="FILE", type=_FILE, default=_OUTPUT, show_default=True, help="The DBC."
)
@click.option(
    "--page",
    "page_path",
    metavar="FILE",
    type=_FILE,
    default=_PAGE,
    show_default=True,
    help="The protocol as a page for people.",
)
def command(check: bool, source: Path, output: Path, page_path: Path) -> None:
    """Generate both files, or compare them."""
    if not source.exists() and source == _DEFINITION:
        remedy = "run this in the source tree, or name the file with --definition"
        raise MissingInputError(Problem("is not here", str(source), remedy))
    defined = definition.load(source)
    generated = {output: dbc.write(defined), page_path: docs_page.write(defined)}
    stale = {path: text for path, text in generated.items() if _current(path) != text}
    if check:
        _report_stale(stale, _mending(source, output, page_path))
        return
    for path in generated:
        if path in stale:
            _replace(path, stale[path])
        click.echo(f"{path} {'written' if path in stale else 'is current'}")


def _current(path: Path) -> str | None:
    """The file's text; None where there is none, or none that could be ours."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            return file.read()
    except (FileNotFoundError, UnicodeDecodeError):
        return None
    except OSError as error:
        problem = Problem(f"cannot be read: {error.strerror or error}", str(path))
        raise MissingInputError(problem) from error


def _mending(source: Path, output: Path, page_path: Path) -> str:
    chosen = (
        ("--definition", source, _DEFINITION),
        ("--output", output, _OUTPUT),
        ("--page", page_path, _PAGE),
    )
    named = [part for name, path, usual in chosen if path != usual for part in (name, str(path))]
    return shlex.join(["vcu-gateway", "dbc", *named])


def _report_stale(stale: dict[Path, str], mending: str) -> None:
    for path, text in stale.items():
        there = _current(path)
        what = "is missing" if there is None else "is not what the definition says"
        click.echo(f"{path} {what}: run `{mending}`", err=True)
        difference = difflib.unified_diff(
            (there or "").splitlines(),
            text.splitlines(),
            f"{path} as it is",
            "generated",
            lineterm="",
        )
        for line in islice(difference, _SHOWN_LINES):
            click.echo(f"  {line}", err=True)
    if stale:
        raise SystemExit(1)


def _replace(path: Path, text: str) -> None:
    """Write the whole file or nothing, also through a symbolic link."""
    target = path.resolve()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        mode = target.stat().st_mode & 0o777 if target.exists() else 0o644
        handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name}.")
        try:
            with os.fdopen(handle, "w", encoding="utf-8", newline="") as file:
                file.write(text)
            os.chmod(name, mode)
            os.replace(name, target)
        except BaseException:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(name)
            raise
    except OSError as error:
        problem = Problem(f"cannot be written: {error.strerror or error}", str(path))
        raise UnavailableError(problem) from error
