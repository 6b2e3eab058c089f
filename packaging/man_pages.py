"""Write the man pages from the command line itself: `man_pages.py FOLDER`.

One page for the program and one for each verb. Descriptions and options are what `--help` says,
exit codes what `vcu_gateway.errors` says. SOURCE_DATE_EPOCH is the date in the footer.
"""

import os
import re
import sys
import time
from collections.abc import Iterable, Iterator
from inspect import cleandoc
from pathlib import Path

import click

from vcu_gateway import __version__, errors
from vcu_gateway.cli import group

_PROGRAM = "vcu-gateway"

_FILES = {
    "/etc/vcu-gateway/gateway.yaml": "The configuration, every key with unit, default and limits.",
    "/etc/vcu-gateway/INSTANCE.yaml": "That of vcu-gateway@INSTANCE.service.",
    "/run/vcu-gateway/control.sock": "The socket of the API, while the gateway runs.",
    "/var/lib/vcu-gateway": "What is recorded by hand.",
    "/run/vcu-gateway-recorder/status.json": "What the recorder does, while it runs.",
    "/var/lib/vcu-gateway-recorder": "The recordings: drives and incidents.",
    "/usr/share/vcu-gateway/network": "Examples for systemd-networkd; not in effect by themselves.",
    "/usr/share/vcu-gateway/examples": "Scenarios for the simulator, a drop-in for the unit.",
    "/usr/share/doc/vcu-gateway/docs": "How to install, operate and judge the gateway.",
}

_ENVIRONMENT = {"VCU_GATEWAY_SOCKET": "The socket of the gateway that is asked, as --socket."}


def main(folder: Path) -> None:
    """Write every page into the folder, which is made where it is missing."""
    folder.mkdir(parents=True, exist_ok=True)
    top = click.Context(group, info_name=_PROGRAM, **group.context_settings)
    _write(folder, _PROGRAM, _main_page(top))
    for verb in group.list_commands(top):
        if command := group.get_command(top, verb):
            context = click.Context(command, info_name=verb, parent=top)
            _write(folder, f"{_PROGRAM}-{verb}", _verb_page(context, _verbs(top)[verb]))
            _write_verbs_of(folder, context)


def _write_verbs_of(folder: Path, parent: click.Context) -> None:
    """The pages of a verb that has verbs of its own."""
    if not isinstance(parent.command, click.Group):
        return
    for verb, command in parent.command.commands.items():
        context = click.Context(command, info_name=verb, parent=parent)
        name = context.command_path.replace(" ", "-")
        _write(folder, name, _verb_page(context, command.get_short_help_str(200)))


def _write(folder: Path, name: str, lines: Iterable[str]) -> None:
    text = "\n".join([_title(name), ".nh", ".ad l", *lines]) + "\n"
    (folder / f"{name}.1").write_text(text, encoding="utf-8")


def _title(name: str) -> str:
    epoch_s = int(os.environ.get("SOURCE_DATE_EPOCH", time.time()))
    date = time.strftime("%Y-%m-%d", time.gmtime(epoch_s))
    return f'.TH {_plain(name.upper())} 1 "{date}" "{_PROGRAM} {__version__}" "{_PROGRAM}"'


def _main_page(context: click.Context) -> Iterator[str]:
    summary = cleandoc(group.help or "").partition("\n")[0].rstrip(".")
    yield from _head(_PROGRAM, summary, context)
    yield from _description(group)
    yield ".SH COMMANDS"
    for verb, says in _verbs(context).items():
        yield from (".TP", f".BR {_plain(f'{_PROGRAM}-{verb}')} (1)", _line(says))
    yield from _options(context)
    yield from _tail("systemctl")


def _verb_page(context: click.Context, summary: str) -> Iterator[str]:
    yield from _head(context.command_path.replace(" ", "-"), summary, context)
    yield from _description(context.command)
    if isinstance(context.command, click.Group):
        yield ".SH COMMANDS"
        for verb, command in context.command.commands.items():
            page = f"{context.command_path} {verb}".replace(" ", "-")
            yield from (".TP", f".BR {_plain(page)} (1)", _line(command.get_short_help_str(200)))
    yield from _options(context)
    yield from _tail(_PROGRAM)


def _verbs(context: click.Context) -> dict[str, str]:
    """Name and what it does, as the program's own help lists them."""
    listed = click.HelpFormatter(width=1000)
    group.format_commands(context, listed)
    rows = [line.strip() for line in listed.getvalue().splitlines()[1:] if line.strip()]
    return dict(re.split(r"\s{2,}", row, maxsplit=1) for row in rows)


def _head(name: str, summary: str, context: click.Context) -> Iterator[str]:
    usage = " ".join(context.command.collect_usage_pieces(context))
    yield from (".SH NAME", f"{_plain(name)} \\- {_plain(summary)}")
    yield from (".SH SYNOPSIS", f"\\fB{_plain(context.command_path)}\\fR {_plain(usage)}")


def _description(command: click.Command) -> Iterator[str]:
    yield ".SH DESCRIPTION"
    first, *others = cleandoc(command.help or "").split("\n\n")
    yield from _paragraph(first)
    for paragraph in others:
        yield from (".PP", *_paragraph(paragraph))


def _paragraph(text: str) -> Iterator[str]:
    """Filled, or line by line where it begins with click's mark for that."""
    if not text.startswith("\b"):
        yield from map(_line, text.splitlines())
        return
    yield ".nf"
    yield from map(_line, text.splitlines()[1:])
    yield ".fi"


def _options(context: click.Context) -> Iterator[str]:
    yield ".SH OPTIONS"
    for parameter in context.command.get_params(context):
        record = parameter.get_help_record(context)
        if record and isinstance(parameter, click.Option):
            yield from (".TP", f"\\fB{_plain(record[0])}\\fR", _line(record[1] or "A switch."))


def _tail(other: str) -> Iterator[str]:
    yield from _listed("EXIT STATUS", _exit_codes())
    yield from _listed("ENVIRONMENT", _ENVIRONMENT)
    yield from _listed("FILES", _FILES)
    yield from (".SH SEE ALSO", f".BR {_plain(other)} (1)")


def _listed(heading: str, entries: dict[str, str]) -> Iterator[str]:
    yield f".SH {heading}"
    for name, says in entries.items():
        yield from (".TP", f"\\fB{_plain(name)}\\fR", _line(says))


def _exit_codes() -> dict[str, str]:
    """The table in the docstring of `vcu_gateway.errors`."""
    return dict(re.findall(r"^ +(\d+) +(\S.*)$", errors.__doc__ or "", flags=re.MULTILINE))


def _line(text: str) -> str:
    """A line that begins with no request."""
    plain = _plain(text)
    return f"\\&{plain}" if plain.startswith((".", "'")) else plain


def _plain(text: str) -> str:
    """Text with nothing in it that means anything to roff."""
    return text.replace("\\", "\\e").replace("-", "\\-")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
