"""`vcu-gateway dbc`: the DBC, its module and the protocol page, from the definition."""

import shlex
from pathlib import Path

import click

from vcu_gateway.cli import generated as files
from vcu_gateway.errors import MissingInputError, Problem
from vcu_gateway.protocol import cantools_dbc, dbc_module, definition, docs_page

_DEFINITION = Path("dbc/vcu.yaml")
_OUTPUT = Path("dbc/vcu.dbc")
_MODULE = Path("src/vcu_gateway/protocol/vcu_dbc.py")
_PAGE = Path("docs/protocol.md")

_HELP = """Generate the DBC, its module and the protocol page from the definition.

The module is what cantools reads in the DBC, as Python data: the gateway starts without cantools,
unless its configuration names another DBC.

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
    "--module",
    "module_path",
    metavar="FILE",
    type=_FILE,
    default=_MODULE,
    show_default=True,
    help="What the DBC says, as Python data.",
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
def command(check: bool, source: Path, output: Path, module_path: Path, page_path: Path) -> None:
    """Generate the files, or compare them."""
    if not source.exists() and source == _DEFINITION:
        remedy = "run this in the source tree, or name the file with --definition"
        raise MissingInputError(Problem("is not here", str(source), remedy))
    defined = definition.load(source)
    dbc_text = cantools_dbc.write(defined)
    generated = {
        output: dbc_text,
        module_path: dbc_module.write(dbc_text),
        page_path: docs_page.write(defined),
    }
    if check:
        how_to_fix = _command_line(source, output, module_path, page_path)
        files.check(generated, "the definition", how_to_fix)
        return
    for path, text in generated.items():
        is_stale = files.current(path) != text
        if is_stale:
            files.replace(path, text)
        click.echo(f"{path} {'written' if is_stale else 'is current'}")


def _command_line(source: Path, output: Path, module_path: Path, page_path: Path) -> str:
    chosen = (
        ("--definition", source, _DEFINITION),
        ("--output", output, _OUTPUT),
        ("--module", module_path, _MODULE),
        ("--page", page_path, _PAGE),
    )
    named = [part for name, path, usual in chosen if path != usual for part in (name, str(path))]
    return shlex.join(["vcu-gateway", "dbc", *named])
