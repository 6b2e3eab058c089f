"""`vcu-gateway decode` and `export`: recordings as JSON lines, CSV, MF4, Parquet, MCAP or HTML."""

import contextlib
import io
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import click

from vcu_gateway import text
from vcu_gateway.cli.options import file_option, moment_of
from vcu_gateway.core.codec import Codec, Reason
from vcu_gateway.errors import DataError, GatewayError, Problem, UnavailableError, did_you_mean
from vcu_gateway.export import formats
from vcu_gateway.export.source import ReadOptions, Selection, Source, read, title
from vcu_gateway.protocol import DEFAULT_ALIASES, dbc, packaged
from vcu_gateway.recording.decoded import FORMATS, FrameWriter, Summary
from vcu_gateway.recording.folder import recording_path
from vcu_gateway.recording.log import Recording, open_recording
from vcu_gateway.time_window import Window

_no_alias_option = click.option(
    "--no-alias",
    is_flag=True,
    help="Do not take 0x08F02DE2 for IMU_Attitude (docs/protocol.md E3).",
)

_DECODE_HELP = """Decode the recording LOG to one JSON object a frame, or to CSV.

LOG is what candump -l or candump -L writes (.log, also through a pipe with `-`), or any other
recording that python-can reads: .asc, .blf, .csv, .db, .mf4, .trc, most of them also with .gz.

\b
A line of JSON:
  {"time": 1700000000.123456, "channel": "can0", "message": "BMS_Status",
   "signals": {"SOC": {"value": 80, "unit": "%", "raw": 80, "quality": "good"}, ...}}

time is the recording's own, in seconds to the microsecond (in .asc since its beginning);
channel is null where the format has none. quality is good, out of range or saturated. A signal
with named codes has a "name", null for a code without one.

CSV has one row a signal, with the columns
time,channel,message,signal,value,unit,raw,quality,name.

What was not decoded is counted by reason on stderr: error and remote frames, 11-bit and
unknown identifiers, known messages from a foreign source, frames shorter or longer than eight
bytes, CAN FD. Frames are matched at any priority.

`vcu-gateway export` writes whole drives and logs for other programs, and as a page with plots.

\b
vcu-gateway decode drive.log | jq -c 'select(.message == "BMS_Status") | .signals.SOC.value'
candump -L can0 | vcu-gateway decode -
"""


@click.command("decode", help=_DECODE_HELP)
@click.argument("log", metavar="LOG")
@click.option(
    "--format",
    "format_name",
    type=click.Choice(list(FORMATS)),
    default="jsonl",
    show_default=True,
    help="How to write it.",
)
@file_option(
    "-o",
    "--output",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write here instead of stdout; an old FILE is replaced.",
)
@click.option(
    "--message", "messages", metavar="NAME", multiple=True, help="Only this message; repeatable."
)
@_no_alias_option
@file_option("--dbc", "dbc_path", help="Decode with this DBC instead of the program's own.")
def decode(
    log: str,
    format_name: str,
    output: Path | None,
    messages: tuple[str, ...],
    no_alias: bool,
    dbc_path: Path | None,
) -> None:
    protocol = dbc.load(dbc_path or packaged("vcu.dbc"))
    codec = Codec(dbc.with_aliases(protocol, {} if no_alias else DEFAULT_ALIASES))
    text_format = FORMATS[format_name]
    writers = _writers(codec, messages, text_format)
    try:
        with open_recording(log, text.say) as recording, _opened(output, log) as out:
            out.write(text_format.head)
            _decode_all(recording, codec, writers, out)
    except BrokenPipeError:
        raise  # the reader is gone (`| head`): that is no failure
    except OSError as error:
        # Reading turns its own into GatewayErrors.
        what = f"cannot be written: {error.strerror or error}"
        raise UnavailableError(Problem(what, str(output or "standard output"))) from error


def _writers(
    codec: Codec, wanted: tuple[str, ...], text_format: type[FrameWriter]
) -> dict[str, FrameWriter]:
    for name in wanted:
        if name not in codec.by_name:
            near = did_you_mean(name, codec.by_name, cutoff=0.4)
            meant = f"; {near}" if near else ""
            known = ", ".join(codec.by_name)
            raise click.BadParameter(f"no message {name}{meant} Known are {known}.")
    return {
        name: text_format(message.spec)
        for name, message in codec.by_name.items()
        if not wanted or name in wanted
    }


@contextlib.contextmanager
def _opened(output: Path | None, log: str) -> Iterator[TextIO]:
    if output is None:
        if isinstance(sys.stdout, io.TextIOWrapper):
            sys.stdout.reconfigure(encoding="utf-8")
        yield sys.stdout
        return
    if output.exists() and os.path.exists(log) and output.samefile(log):
        raise click.BadParameter(f"{output} is the recording itself.")
    with output.open("w", encoding="utf-8", newline="") as out:
        yield out


def _decode_all(
    recording: Recording, codec: Codec, writers: dict[str, FrameWriter], out: TextIO
) -> None:
    summary = Summary()
    try:
        _decode(recording, codec, writers, out, summary)
        out.flush()
    except (GatewayError, KeyboardInterrupt):
        _sum_up(summary, recording.problems.unreadable)
        raise
    _sum_up(summary, recording.problems.unreadable)
    if not summary.frames:
        remedy = "" if recording.problems.unreadable else "it is empty"
        raise DataError(Problem("holds no frame that can be read", recording.name, remedy))


def _decode(
    recording: Recording,
    codec: Codec,
    writers: dict[str, FrameWriter],
    out: TextIO,
    summary: Summary,
) -> None:
    live = recording.live
    for recorded in recording.watched(text.Progress()):
        frame = recorded.frame
        found = codec.find(frame)
        if isinstance(found, Reason):
            summary.reject(found, frame.can_id)
        elif recorded.fd:
            summary.reject_fd()
        elif writer := writers.get(found.spec.name):
            summary.decoded[found.spec.name] += 1
            out.write(writer.text(frame.arrival_ns, recorded.channel, found.decode(frame.data)))
            if live:
                out.flush()
        else:
            summary.passed_over += 1


def _sum_up(summary: Summary, unreadable: int) -> None:
    for line in summary.lines(unreadable):
        text.say(line)


_EXPORT_HELP = """Write the recording NAME in a format that other programs read.

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


@click.command("export", help=_EXPORT_HELP)
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
@file_option(
    "-o",
    "--output",
    help="Write here; an old FILE is replaced. Default: NAME with the format's suffix, here.",
)
@click.option(
    "--signals",
    "patterns",
    metavar="GLOB",
    multiple=True,
    help="Only these: Message.Signal, a message or a signal, with * and ?; repeatable.",
)
@_no_alias_option
@file_option(
    "--dbc",
    "dbc_path",
    help="Decode with this DBC instead of the recording's or the program's own.",
)
def export(
    name: str,
    ends: tuple[str, ...],
    begin: str | None,
    output: Path | None,
    patterns: tuple[str, ...],
    no_alias: bool,
    dbc_path: Path | None,
) -> None:
    kind, window = _format_and_window(ends, begin)
    name = str(recording_path(name))
    path = _target(output, name, kind)
    formats.check(kind)
    selection = Selection(patterns)
    progress = text.Progress()

    def report(problem: Problem) -> None:
        progress.clear()
        text.say(problem)

    source = read(name, ReadOptions(window, report, progress.show_frames, dbc_path, not no_alias))
    progress.clear()
    try:
        tables = formats.tables_of(source, selection)
        _check_selection(source, selection)
        formats.write(source, tables, selection, kind, path)
    finally:
        source.store.close()
    _sum_up(source.store.summary, source.unreadable)
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
