"""Options of `vcu-gateway replay`, and the lines and values that answer them."""

import sys
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import click

from vcu_gateway.drive.records import Checkpoint, CoreRecord, FrameRun
from vcu_gateway.recording import Recording
from vcu_gateway.time_window import Moment, Window, moment

_PROGRESS_PERIOD_S = 0.5
_LOOK_EVERY = 4096

Record = FrameRun | CoreRecord
"""What a drive is read as."""


class ReplayOptions(NamedTuple):
    """What the command line asks for."""

    recording: str
    config_path: Path | None
    assignments: tuple[str, ...]
    closed_loop: bool
    begin: str | None
    end: str | None
    demand_pct: float | None
    as_json: bool
    html_path: Path | None
    quiet: bool

    @property
    def what_if(self) -> bool:
        """True where another configuration is given."""
        return self.config_path is not None or bool(self.assignments)

    @property
    def window(self) -> Window:
        """The part that is asked for."""
        return window_of(self.begin, self.end)


class ReplayReport(NamedTuple):
    """Answer: as lines for a terminal, as values for JSON, and the exit code."""

    lines: list[str]
    values: dict[str, Any]
    exit_code: int


def window_of(begin: str | None, end: str | None) -> Window:
    """The part between two times; BadParameter where one is no time."""
    return Window(_moment(begin, "--from"), _moment(end, "--to"))


def _moment(text: str | None, option: str) -> Moment | None:
    if text is None:
        return None
    try:
        return moment(text)
    except ValueError:
        what = f"{text!r} is no time such as 90.5, 12:03:14.150 or 2026-11-23T12:03:14."
        raise click.BadParameter(what, param_hint=f"'{option}'") from None


def watched(records: Iterable[Record], segments: int, quiet: bool) -> Iterator[Record]:
    """The records, with a line of progress where a person waits."""
    if quiet or not sys.stderr.isatty():
        yield from records
        return
    shown_s, segment = time.monotonic(), 0
    for count, record in enumerate(records):
        if type(record) is Checkpoint:
            segment += 1
        if count % _LOOK_EVERY == 0 and time.monotonic() - shown_s > _PROGRESS_PERIOD_S:
            shown_s = time.monotonic()
            click.echo(f"\rsegment {segment} of {segments} ", nl=False, err=True)
        yield record
    click.echo("\r\033[K", nl=False, err=True)


def progress(steps: Iterable[None], recording: Recording, quiet: bool) -> Iterator[None]:
    """The steps, with a line of progress where a person waits for a log."""
    if quiet or recording.live or not sys.stderr.isatty():
        yield from steps
        return
    shown_s = time.monotonic()
    for count, step in enumerate(steps):
        if count % _LOOK_EVERY == 0 and time.monotonic() - shown_s > _PROGRESS_PERIOD_S:
            shown_s = time.monotonic()
            share = recording.share_read() or 0.0
            click.echo(f"\r{share:4.0%}, {count} frames ", nl=False, err=True)
        yield step
    click.echo("\r\033[K", nl=False, err=True)
