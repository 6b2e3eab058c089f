"""Replay of a recorded drive for the command line."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click

from vcu_gateway import __version__
from vcu_gateway.cli.beside import beside
from vcu_gateway.cli.recordings_text import check_headline, check_json, fault_lines
from vcu_gateway.cli.replay_html import write_html
from vcu_gateway.cli.replay_options import Record, ReplayOptions, ReplayReport, watched
from vcu_gateway.core.codec import Codec
from vcu_gateway.drive.checkpoint import StateError
from vcu_gateway.drive.reader import Drive, open_drive
from vcu_gateway.drive_format import layout
from vcu_gateway.errors import DataError, Problem
from vcu_gateway.judge import DriveVerdict
from vcu_gateway.recordings import RecordingPath, check_recording
from vcu_gateway.recordings.check import RecordingState
from vcu_gateway.replay import drive_records, equality_text, what_if_text
from vcu_gateway.replay.closed_loop import ClosedLoop
from vcu_gateway.replay.commands import CommandSeries
from vcu_gateway.replay.equality import BUGS, EqualityCheck, NotReplayed
from vcu_gateway.replay.given_settings import GivenConfiguration, given
from vcu_gateway.replay.judged import JudgedRecords
from vcu_gateway.replay.open_loop import OpenLoop
from vcu_gateway.replay.tables import counted
from vcu_gateway.replay.time_of_day import TimeOfDay
from vcu_gateway.replay.what_if_values import what_if_values
from vcu_gateway.strict_yaml import file_text

_MOST_FAULTS = 10
_CLOSED_LOOP = (
    "closed loop: the recorded demands and requests drive a simulated vehicle, which stands still"
    " at the beginning and knows nothing of what was wrong with the recorded one; both sides are"
    " simulated"
)


def report(asked: ReplayOptions, path: Path) -> ReplayReport:
    """Replay as asked; DataError where the recorded state cannot be used."""
    if asked.demand_pct is not None:
        raise click.BadParameter("a recorded drive has its own demands", param_hint="--demand")
    drive = open_drive(path)
    if not drive.segments:
        raise DataError(Problem("has no segment", str(path), "the recorder had written nothing"))
    replayed = _DriveReplay(asked, drive, path)
    try:
        if asked.closed_loop:
            return replayed.closed_loop()
        return replayed.open_loop() if asked.what_if else replayed.check()
    except StateError as error:
        written = drive.info.versions.get("gateway", "unknown")
        what = f"its state cannot be used: {error}"
        remedy = f"it was written by vcu-gateway {written}, this is {__version__}"
        raise DataError(Problem(what, str(path), remedy)) from error


class _DriveReplay:
    """One drive and what is asked of it."""

    def __init__(self, asked: ReplayOptions, drive: Drive, path: Path) -> None:
        self._asked, self._path = asked, path
        self._drive = drive
        self._clock = TimeOfDay(drive.info.clock.distance_ns)
        self._protocol = drive_records.protocol_of(drive)
        self._window = asked.window
        is_incident = bool(layout.incident_files(drive.folder))
        recording = RecordingPath("incident" if is_incident else "drive", drive.folder)
        self._checked = check_recording(recording, lambda _: None)

    def _replay(self, note: Callable[[Record], None]) -> None:
        shown = watched(self._records(), len(self._drive.segments), self._asked.quiet)
        with self._telling_where():
            for record in shown:
                note(record)

    def _records(self) -> Iterator[Record]:
        return drive_records.records(self._drive, self._window, self._clock)

    @contextlib.contextmanager
    def _telling_where(self) -> Iterator[None]:
        """DataError with the line that a core failed at."""
        try:
            yield
        except StateError:
            raise
        except BUGS as error:
            what = f"cannot be decided again ({type(error).__name__}: {error})"
            remedy = (
                "was it changed by hand? If not, this version of the gateway has a bug: keep the"
                " recording"
            )
            raise DataError(Problem(what, self._drive.place, remedy)) from error

    def _verdict(self) -> DriveVerdict:
        judged = JudgedRecords(self._drive.info.settings, self._protocol.aliases)
        with self._telling_where():
            for record in self._records():
                judged.note(record)
        return judged.verdict()

    def check(self) -> ReplayReport:
        """With the recorded configuration, and a verdict, which takes half as long again."""
        check = EqualityCheck(Codec(self._protocol))
        with beside(self._verdict) as judged:
            self._replay(check.note)
            equality, clock = check.result(), self._clock
            why = equality.gaps[0].why if equality.gaps else ""
            self._check_ticks(equality.ticks, equality.ended_ns, why)
            verdict = judged()
        lines = [
            self._title(),
            *self._recording_lines(),
            *equality_text.equality_lines(equality, clock),
            *equality_text.verdict_lines(verdict, clock),
        ]
        values = self._values() | {
            "replay": equality_text.equality_values(equality, clock),
            "verdict": equality_text.verdict_values(verdict, clock),
        }
        if self._asked.html_path is not None:
            head = list(equality_text.equality_lines(equality, clock))
            write_html(self._asked, str(self._path), head[:2], head[0])
        return ReplayReport(lines, values, self._exit_code(equality.equal and verdict.holds))

    def _recording_lines(self) -> Iterator[str]:
        """What a check of the recording found."""
        found = self._checked
        yield f"recording: {check_headline(found)}"
        yield from fault_lines(found, _MOST_FAULTS)

    def _exit_code(self, same: bool) -> int:
        """Changed or damaged, else different, else incomplete; the first and last of a chain."""
        found = self._checked
        if found.is_chained and (same or found.state is RecordingState.CHANGED):
            return found.exit_code
        return 0 if same else 1

    def open_loop(self) -> ReplayReport:
        """With the given configuration, on the recorded inputs."""
        configured = self._given()
        codec = self._codec(configured)
        series = self._series(codec)
        loop = OpenLoop(codec, configured.settings, series)
        self._replay(loop.note)
        result, clock = loop.what_if.result(), self._clock
        notes = [_open_loop(result.first_ns, clock), *self._notes(configured)]
        if loop.reloads:
            notes.append(_reloads(len(loop.reloads), clock.clock(loop.reloads[0])))
        gaps = tuple(
            NotReplayed(1, at_ns, one.ticks, one.frames, one.why) for at_ns, one in loop.gaps
        )
        notes += [
            f"{line}; from there on it begins with the recorded state"
            for line in equality_text.gap_lines(gaps, clock)
        ]
        return self._answer(result, notes, series, "open loop")

    def closed_loop(self) -> ReplayReport:
        """With a simulated vehicle, once with each configuration."""
        configured = self._given()
        codec = self._codec(configured)
        series = self._series(codec)
        loop = ClosedLoop(codec, None, configured.settings, series)
        self._replay(loop.note)
        (slow, fast), (near, far) = loop.speeds_km_h, loop.distances_m
        notes = [
            _CLOSED_LOOP,
            f"highest speed {slow:.1f} -> {fast:.1f} km/h, distance {near:.0f} -> {far:.0f} m",
            *self._notes(configured),
        ]
        if loop.reloads:
            notes.append(_reloads(loop.reloads))
        return self._answer(loop.what_if.result(), notes, series, "closed loop")

    def _check_ticks(self, ticks: int, ended_ns: int, why: str = "") -> None:
        """DataError where there was nothing to replay, or not of the time that was asked for."""
        window, clock = self._window, self._clock
        if not window.open and (not ticks or clock.wall_ns(ended_ns) < window.bounds_ns(0)[0]):
            what, remedy = "has nothing of that time", "all times are UTC"
        elif not ticks:
            what = f"has no tick that can be replayed{why and ': '}{why}"
            remedy = "vcu-gateway recordings check says what is damaged"
        else:
            return
        raise DataError(Problem(what, str(self._path), remedy))

    def _answer(
        self, result: Any, notes: list[str], series: CommandSeries | None, kind: str
    ) -> ReplayReport:
        clock = self._clock
        self._check_ticks(result.ticks, result.ended_ns)
        lines = [self._title(), *self._recording_lines(), *_given_lines(self._asked), *notes, ""]
        lines += what_if_text.what_if_lines(result, clock)
        values = self._values() | {
            "what_if": {
                "loop": kind,
                "given": list(_given_lines(self._asked)),
                "notes": notes,
                **what_if_values(result, clock),
            }
        }
        if self._asked.html_path is not None:
            what_if = [*_given_lines(self._asked), *notes]
            write_html(
                self._asked,
                str(self._path),
                what_if,
                what_if_text.headline(result, clock),
                (result, clock, series),
                only_changes=kind == "open loop",
            )
        return ReplayReport(lines, values, self._exit_code(result.same))

    def _given(self) -> GivenConfiguration:
        path = self._asked.config_path
        text, where = self._drive.info.config, str(self._drive.folder / "config.yaml")
        if path is not None:
            text, where = file_text.read(path), str(path)
        return given(text, where, self._asked.assignments, self._protocol)

    def _codec(self, configured: GivenConfiguration) -> Codec:
        return Codec(drive_records.with_aliases(self._protocol, configured.aliases))

    def _series(self, codec: Codec) -> CommandSeries | None:
        return None if self._asked.html_path is None else CommandSeries(codec)

    def _notes(self, configured: GivenConfiguration) -> Iterator[str]:
        yield from configured.without_effect
        written = self._drive.info.versions.get("gateway", "unknown")
        if written != __version__:
            yield (
                f"recorded by vcu-gateway {written}, replayed by {__version__}: see without -c and"
                " --set whether both decide the same"
            )

    def _title(self) -> str:
        info = self._drive.info
        name = self._drive.folder.resolve().name
        segments = len(self._drive.segments)
        return (
            f"{name} on {info.channel}, vcu-gateway {info.versions.get('gateway', 'unknown')},"
            f" {segments} segment{'' if segments == 1 else 's'}"
        )

    def _values(self) -> dict[str, Any]:
        info = self._drive.info
        return {
            "recording": str(self._drive.folder),
            "run": info.run,
            "channel": info.channel,
            "recorded_by": info.versions,
            "replayed_by": __version__,
            "check": check_json(self._checked),
        }


def _given_lines(asked: ReplayOptions) -> Iterator[str]:
    given_texts = [*asked.assignments]
    if asked.config_path is not None:
        given_texts.insert(0, str(asked.config_path))
    if given_texts:
        yield f"what if: {', '.join(given_texts)}"


def _open_loop(first_ns: int | None, clock: TimeOfDay) -> str:
    if first_ns is None:
        return "open loop: the recorded vehicle does not react; no command differs"
    return (
        "open loop: the recorded vehicle does not react. From"
        f" {clock.clock(first_ns)} on, the first command that differs, it answers what it answered"
        " to the recorded commands, and its echoes are held against those (--closed-loop: a"
        " simulated one reacts)"
    )


def _reloads(count: int, first: str = "") -> str:
    times = f", the first at {first}" if first else ""
    return (
        f"{counted(count, 'recorded reload')} left out{times}: the given configuration holds for"
        " the whole drive"
    )
