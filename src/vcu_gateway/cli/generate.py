"""`vcu-gateway schema` and `dbc`: what is made from configuration, API and protocol."""

import difflib
import json
import shlex
from collections.abc import Iterable
from itertools import islice
from pathlib import Path

import click

from vcu_gateway import files
from vcu_gateway.cli.options import Option
from vcu_gateway.errors import MissingInputError, Problem, UnavailableError
from vcu_gateway.protocol import cantools_dbc, definition


@click.command("schema")
@click.option("--yaml", "as_yaml", is_flag=True, help="Print every key at its default, as YAML.")
@click.option("--api", "of_api", is_flag=True, help="Of the API instead: an OpenRPC document.")
def schema(as_yaml: bool, of_api: bool) -> None:
    """Print the JSON Schema of the configuration file.

    With it an editor completes and checks keys: save it as schema.json beside the
    configuration and begin that file with `# yaml-language-server: $schema=schema.json`.
    """
    if as_yaml and of_api:
        raise click.UsageError("--yaml and --api exclude each other")
    if as_yaml:
        from vcu_gateway.protocol import packaged

        click.echo(packaged("gateway.yaml").read_text(encoding="utf-8"), nl=False)
    elif of_api:
        from vcu_gateway.api import openrpc

        click.echo(json.dumps(openrpc.document(), indent=2))
    else:
        from vcu_gateway import config

        click.echo(json.dumps(config.schema(), indent=2))


_DEFINITION = Path("dbc/vcu.yaml")
_OUTPUT = Path("dbc/vcu.dbc")
_MODULE = Path("src/vcu_gateway/protocol/vcu_dbc.py")
_SHOWN_LINES = 20

_HELP = """Generate the DBC and its module from the definition.

The module is what cantools reads in the DBC, as Python data: the gateway starts without cantools,
unless its configuration names another DBC.

The files are those of the source tree in the current directory, unless they are named. With
--check nothing is written: the exit code is 1 where a file is not what the definition says, and
the first differing lines are shown.
"""

_FILE = click.Path(dir_okay=False, path_type=Path)


def _file(name: str, parameter: str, usual: Path, text: str) -> Option:
    return click.option(
        name, parameter, metavar="FILE", type=_FILE, default=usual, show_default=True, help=text
    )


@click.command("dbc", help=_HELP)
@click.option("--check", is_flag=True, help="Write nothing; exit 1 where a file is stale.")
@_file("--definition", "source", _DEFINITION, "The protocol, written once.")
@_file("--output", "output", _OUTPUT, "The DBC.")
@_file("--module", "module_path", _MODULE, "What the DBC says, as Python data.")
def dbc(check: bool, source: Path, output: Path, module_path: Path) -> None:
    if not source.exists() and source == _DEFINITION:
        remedy = "run this in the source tree, or name the file with --definition"
        raise MissingInputError(Problem("is not here", str(source), remedy))
    dbc_text = cantools_dbc.write(definition.load(source))
    generated = {output: dbc_text, module_path: cantools_dbc.module_text(dbc_text)}
    stale = {path: text for path, text in generated.items() if _current(path) != text}
    if check:
        for path, text in stale.items():
            _report(path, text, _command_line(source, output, module_path))
        raise SystemExit(1 if stale else 0)
    for path, text in generated.items():
        if path in stale:
            replace(path, text)
        click.echo(f"{path} {'written' if path in stale else 'is current'}")


def _command_line(source: Path, output: Path, module_path: Path) -> str:
    chosen = (
        ("--definition", source, _DEFINITION),
        ("--output", output, _OUTPUT),
        ("--module", module_path, _MODULE),
    )
    named = [part for name, path, usual in chosen if path != usual for part in (name, str(path))]
    return shlex.join(["vcu-gateway", "dbc", *named])


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


def _report(path: Path, text: str, how_to_fix: str) -> None:
    there = _current(path)
    what = "is missing" if there is None else "is not what the definition says"
    click.echo(f"{path} {what}: run `{how_to_fix}`", err=True)
    for line in differences(path, there or "", text):
        click.echo(line, err=True)


def differences(path: Path | str, there: str, text: str) -> Iterable[str]:
    """The first lines in which the file's text is not the generated one."""
    lines = difflib.unified_diff(
        there.splitlines(), text.splitlines(), f"{path} as it is", "generated", lineterm=""
    )
    return (f"  {line}" for line in islice(lines, _SHOWN_LINES))


def replace(path: Path, text: str) -> None:
    """Write the whole file or nothing, also through a symbolic link."""
    target = path.resolve()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        mode = target.stat().st_mode & 0o777 if target.exists() else 0o644
        files.replace(target, text, mode)
    except OSError as error:
        problem = Problem(f"cannot be written: {error.strerror or error}", str(path))
        raise UnavailableError(problem) from error
