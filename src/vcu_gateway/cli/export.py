"""`vcu-gateway export`: a drive, an incident or a log as MF4, CSV, Parquet, MCAP or HTML."""

from pathlib import Path

import click

from vcu_gateway import text
from vcu_gateway.cli.options import moment_of
from vcu_gateway.errors import Problem, did_you_mean
from vcu_gateway.export import formats
from vcu_gateway.export.source import ReadOptions, Selection, Source, read, title
from vcu_gateway.recording.folder import recording_path
from vcu_gateway.time_window import Window

_HELP = """Write the recording NAME in a format that other programs read.

NAME is the folder of a drive or an incident, its name below /var/lib/vcu-gateway-recorder, one of
its files, or a log of the bus as `decode` takes it: candump, .asc, .blf, .mf4 and others.

\b
--to html     one page with plots for a browser; it loads nothing from a network
--to csv      a row each 50 ms, a column a signal
--to mf4      ASAM MDF 4.10, for CANape or asammdf: a group a message (extra mf4)
--to parquet  a folder, for pandas or DuckDB: a file a message (extra parquet)
--to mcap     for Foxglove or PlotJuggler: a topic a message, in JSON (extra mcap)

Signals have their units; what a controller was told stands beside what it said. The gateway's
modes, causes, events and reasons are channels, too; its configuration and DBC are attached.

--from and a second --to name a part of it: seconds since the beginning (90, 90.5), a time of day
(12:03:14.150, UTC) or a date with it (2026-11-23T12:03:14).

\b
vcu-gateway export 20261123T180412Z-1f3a9c2e --to html
vcu-gateway export drive.log --to csv --signals 'PCU1*' --signals SOC -o pcu1.csv
vcu-gateway export drive.log --to mf4 --from 12:03 --to 12:05
"""


@click.command("export", help=_HELP)
@click.argument("name", metavar="NAME")
@click.option(
    "--to",
    "ends",
    metavar="FORMAT|TIME",
    multiple=True,
    required=True,
    help=f"Format ({', '.join(formats.FORMATS)}); a second one: the end of the part.",
)
@click.option("--from", "begin", metavar="TIME", help="Begin of the part.")
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Write here; an old FILE is replaced. Default: NAME with the format's suffix, here.",
)
@click.option(
    "--signals",
    "patterns",
    metavar="GLOB",
    multiple=True,
    help="Only these: Message.Signal, a message or a signal, with * and ?; repeatable.",
)
@click.option(
    "--no-alias",
    is_flag=True,
    help="Do not take 0x08F02DE2 for IMU_Attitude (docs/protocol.md E3).",
)
@click.option(
    "--dbc",
    "dbc_path",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Decode with this DBC instead of the recording's or the program's own.",
)
def command(
    name: str,
    ends: tuple[str, ...],
    begin: str | None,
    output: Path | None,
    patterns: tuple[str, ...],
    no_alias: bool,
    dbc_path: Path | None,
) -> None:
    """Read, decode and write."""
    kind, window = _format_and_window(ends, begin)
    name = str(recording_path(name))
    path = _target(output, name, kind)
    formats.check(kind)
    selection = Selection(patterns)
    progress = text.Progress()

    def report(problem: Problem) -> None:
        progress.clear()
        text.say(str(problem))

    source = read(name, ReadOptions(window, report, progress.show_frames, dbc_path, not no_alias))
    progress.clear()
    try:
        tables = formats.tables_of(source, selection)
        _check_selection(source, selection)
        formats.write(source, tables, selection, kind, path)
    finally:
        source.store.close()
    for line in source.store.summary.lines(source.unreadable):
        text.say(line)
    click.echo(path)


def _format_and_window(ends: tuple[str, ...], begin: str | None) -> tuple[str, Window]:
    kinds = [one for one in ends if one in formats.FORMATS]
    times = [one for one in ends if one not in formats.FORMATS]
    if len(kinds) != 1 or len(times) > 1:
        near = did_you_mean(times[0], formats.FORMATS) if times and not kinds else ""
        known = ", ".join(formats.FORMATS)
        what = f"one format is needed, of {known}, and at most one end. {near}".strip()
        raise click.BadParameter(what, param_hint="'--to'")
    near = did_you_mean(times[0], formats.FORMATS) if times else ""
    first = moment_of(begin, "--from")
    last = moment_of(times[0] if times else None, "--to", near)
    if first and last and first.kind == last.kind != "time of day" and first.ns > last.ns:
        raise click.BadParameter(f"{begin} is later than {times[0]}.", param_hint="'--from'")
    return kinds[0], Window(first, last)


def _target(output: Path | None, name: str, kind: str) -> Path:
    path = output or Path(f"{title(name)}.{kind}")
    if output is None and path.exists():
        what = f"{path} is there already; name it with -o to replace it."
        raise click.BadParameter(what, param_hint="'-o'")
    if path.exists() and Path(name).exists() and path.samefile(name):
        raise click.BadParameter(f"{path} is the recording itself.", param_hint="'-o'")
    if kind != "parquet" and path.is_dir():
        raise click.BadParameter(f"{path} is a folder.", param_hint="'-o'")
    return path


def _check_selection(source: Source, selection: Selection) -> None:
    unused = selection.unused
    if not unused:
        return
    messages = source.codec.by_name.values()
    known = {one.spec.name for one in messages}
    known |= {name for one in messages for name in one.spec.signal_names}
    near = did_you_mean(unused[0].rpartition(".")[2], known, cutoff=0.5)
    what = f"no signal of this recording is called {unused[0]}; {near or 'see vcu-gateway decode'}"
    raise click.BadParameter(what, param_hint="'--signals'")
