"""`vcu-gateway decode`: a recording as JSON lines or CSV."""

import contextlib
import dataclasses
import io
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TextIO

import click

from vcu_gateway import text
from vcu_gateway.core.codec import Codec, Reason
from vcu_gateway.errors import (
    DataError,
    GatewayError,
    Problem,
    UnavailableError,
    did_you_mean,
)
from vcu_gateway.protocol import DEFAULT_ALIASES, dbc, packaged
from vcu_gateway.recording.candump import RecordedFrame
from vcu_gateway.recording.decoded import FORMATS, FrameFormat, FrameWriter, Summary
from vcu_gateway.recording.log import Recording, open_recording

_HELP = """Decode the recording LOG to one JSON object a frame, or to CSV.

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


@click.command("decode", help=_HELP)
@click.argument("log", metavar="LOG")
@click.option(
    "--format",
    "format_name",
    type=click.Choice(list(FORMATS)),
    default="jsonl",
    show_default=True,
    help="How to write it.",
)
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write here instead of stdout; an old FILE is replaced.",
)
@click.option(
    "--message", "messages", metavar="NAME", multiple=True, help="Only this message; repeatable."
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
    help="Decode with this DBC instead of the program's own.",
)
def command(
    log: str,
    format_name: str,
    output: Path | None,
    messages: tuple[str, ...],
    no_alias: bool,
    dbc_path: Path | None,
) -> None:
    """Read, decode, write, and sum up."""
    codec = _codec(dbc_path, aliased=not no_alias)
    text_format = FORMATS[format_name]
    writers = _writers(codec, messages, text_format)
    try:
        with open_recording(log, _report) as recording, _opened(output, log) as out:
            out.write(text_format.head)
            _decode_all(recording, codec, writers, out)
    except BrokenPipeError:
        # The reader is gone (`| head`): that is no failure, though click would report one.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(0) from None
    except OSError as error:
        # Reading turns its own into GatewayErrors.
        what = f"cannot be written: {error.strerror or error}"
        raise UnavailableError(Problem(what, str(output or "standard output"))) from error


def _report(problem: Problem) -> None:
    text.say(str(problem))


def _codec(dbc_path: Path | None, *, aliased: bool) -> Codec:
    protocol = dbc.load(dbc_path or packaged("vcu.dbc"))
    names = {message.name for message in protocol.messages}
    aliases = {can_id: name for can_id, name in DEFAULT_ALIASES.items() if name in names}
    return Codec(dataclasses.replace(protocol, aliases=aliases if aliased else {}))


def _writers(
    codec: Codec, wanted: tuple[str, ...], text_format: FrameFormat
) -> dict[str, FrameWriter]:
    for name in wanted:
        if name not in codec.by_name:
            near = did_you_mean(name, codec.by_name, cutoff=0.4)
            meant = f"; {near}" if near else ""
            known = ", ".join(codec.by_name)
            raise click.BadParameter(f"no message {name}{meant} Known are {known}.")
    return {
        name: FrameWriter(message.spec, text_format)
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
    try:
        out = output.open("w", encoding="utf-8", newline="")
    except OSError as error:
        what = f"cannot be written: {error.strerror or error}"
        raise UnavailableError(Problem(what, str(output))) from error
    with out:
        yield out


def _decode_all(
    recording: Recording, codec: Codec, writers: dict[str, FrameWriter], out: TextIO
) -> None:
    summary = Summary()
    try:
        _decode(recording, codec, writers, out, summary)
        out.flush()
    except (GatewayError, KeyboardInterrupt):
        _sum_up(summary, recording)
        raise
    _sum_up(summary, recording)
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
    for recorded in _watched(recording):
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


def _watched(recording: Recording) -> Iterable[RecordedFrame]:
    """The frames, with a line of progress where a person waits for a file."""
    if recording.live:
        return recording
    progress = text.Progress()
    return progress.over(
        recording, lambda count: progress.show_frames(recording.share_read(), count)
    )


def _sum_up(summary: Summary, recording: Recording) -> None:
    for line in summary.lines(recording.problems.unreadable):
        text.say(line)
