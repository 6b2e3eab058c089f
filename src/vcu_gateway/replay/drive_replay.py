"""Replay of a recorded drive: is it the same to the byte, does it hold, and what if?

report = replay_drive(Path("drives/20261123T180412Z-1f3a9c2e"))
report = replay_drive(path, Changes(assignments=("limits.power_limit_max_w=5000",)))
report.lines, report.values, report.exit_code

Work in a process beside this one, where the machine has a processor for it.
"""

import contextlib
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from vcu_gateway import __version__
from vcu_gateway.core.codec import Codec
from vcu_gateway.errors import DataError, Problem
from vcu_gateway.export.report import Overlay
from vcu_gateway.judge.result import DriveVerdict
from vcu_gateway.protocol import dbc
from vcu_gateway.recording import check as recording_check
from vcu_gateway.recording import layout
from vcu_gateway.recording.check import RecordingState, check_recording
from vcu_gateway.recording.checkpoint import StateError
from vcu_gateway.recording.core_lines import Checkpoint, CoreRecord, FrameRun, TickRecord
from vcu_gateway.recording.folder import RecordingPath
from vcu_gateway.recording.reader import Drive, open_drive
from vcu_gateway.replay import report
from vcu_gateway.replay.commands import CommandSeries
from vcu_gateway.replay.configuration import Changes, GivenConfiguration
from vcu_gateway.replay.curve_use import CurveUse, GeometryMeasurement
from vcu_gateway.replay.equality import BUGS, EqualityCheck, NotReplayed
from vcu_gateway.replay.judged import JudgedRecords
from vcu_gateway.replay.open_loop import ClosedLoop, OpenLoop
from vcu_gateway.replay.report import ReplayReport, TimeOfDay
from vcu_gateway.replay.what_if import WhatIfResult
from vcu_gateway.text import Progress, counted
from vcu_gateway.time_window import Window

_Result = TypeVar("_Result")


@contextlib.contextmanager
def beside(work: Callable[[], _Result]) -> Iterator[Callable[[], _Result]]:
    """Begin some work; what is given waits for its result, and raises what it raises.

    With one processor, or where its process does not come to its end, the work is done then. It
    must not write anything; for a process of one thread.
    """
    if len(os.sched_getaffinity(0)) < 2:
        yield work
        return
    forked = multiprocessing.get_context("fork")
    answer, end = forked.Pipe(duplex=False)
    child = forked.Process(target=_work, args=(work, end))
    child.start()
    end.close()
    with answer:
        try:
            yield lambda: _result(answer, work)
        finally:
            child.kill()
            child.join()


def _work(work: Callable[[], object], end: Connection) -> None:
    try:
        end.send((work(), None))
    except BaseException as error:  # noqa: BLE001 - raised where the result is waited for
        with contextlib.suppress(Exception):  # one that cannot be handed on is met there again
            end.send((None, error))


def _result(answer: Connection, work: Callable[[], _Result]) -> _Result:
    try:
        found, error = answer.recv()
    except (EOFError, OSError):
        return work()
    if error is not None:
        raise error
    result: _Result = found
    return result


_MOST_FAULTS = 10
_CLOSED_LOOP = (
    "closed loop: the recorded demands and requests drive a simulated vehicle, which stands still"
    " at the beginning and knows nothing of what was wrong with the recorded one; both sides are"
    " simulated"
)


def replay_drive(
    path: Path,
    changes: Changes | None = None,
    window: Window | None = None,
    closed_loop: bool = False,
    plotted: bool = False,
    progress: Progress | None = None,
) -> ReplayReport:
    """Replay a drive, an incident or one segment of it.

    Without changes, with its own configuration; with changes, what if. `closed_loop`: a simulated
    vehicle reacts. `plotted`: the report's page gets the replayed commands. DataError where the
    recording cannot be used, or has nothing of the window; ConfigError for what is given.
    """
    drive = open_drive(path)
    if not drive.segments:
        raise DataError(Problem("has no segment", str(path), "the recorder had written nothing"))
    shown = progress or Progress(wanted=False)
    replayed = _DriveReplay(drive, path, changes or Changes(), window or Window(), shown)
    try:
        if closed_loop:
            return replayed.closed_loop(plotted)
        return replayed.open_loop(plotted) if replayed.changes.names else replayed.check()
    except StateError as error:
        written = drive.info.versions.get("gateway", "unknown")
        what = f"its state cannot be used: {error}"
        remedy = f"it was written by vcu-gateway {written}, this is {__version__}"
        raise DataError(Problem(what, str(path), remedy)) from error


def _checkpoints(drive: Drive) -> Iterator[tuple[int, int]]:
    """Number of each segment that begins with a checkpoint, and its time on the gateway's clock."""
    for files in drive.segments:
        for record in Drive(drive.folder, drive.info, (files,)).runs():
            if type(record) is Checkpoint:
                yield files.number, record.now_ns
                break


class _DriveReplay:
    """One drive and what is asked of it."""

    def __init__(
        self, drive: Drive, path: Path, changes: Changes, window: Window, progress: Progress
    ) -> None:
        self.changes = changes
        self._drive, self._path, self._window, self._progress = drive, path, window, progress
        self._clock = TimeOfDay(drive.info.clock.distance_ns)
        self._protocol = drive.protocol
        is_incident = bool(layout.incident_files(drive.folder))
        recording = RecordingPath("incident" if is_incident else "drive", drive.folder)
        self._checked = check_recording(recording, lambda _: None)

    def _replay(self, note: Callable[[FrameRun | CoreRecord], None]) -> None:
        segment, segments = 0, len(self._drive.segments)

        def show(_: int) -> None:
            self._progress.show(f"segment {segment} of {segments}")

        with self._telling_where():
            for record in self._progress.over(self._records(), show):
                segment += type(record) is Checkpoint
                note(record)

    def _records(self) -> Iterator[FrameRun | CoreRecord]:
        """Those of the window, from the last checkpoint before it to the last tick in it."""
        drive, wall_ns = self._drive, self._clock.wall_ns
        if self._window.open:
            yield from drive.runs()
            return
        begins = {number: wall_ns(now_ns) for number, now_ns in _checkpoints(drive)}
        from_ns, to_ns = self._window.bounds_ns(min(begins.values(), default=0))
        before = [number for number, begun_ns in begins.items() if begun_ns <= from_ns]
        for record in drive.runs(max(before, default=None)):
            if type(record) is TickRecord and wall_ns(record.now_ns) > to_ns:
                return
            yield record

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
        judged = JudgedRecords(self._drive.info.settings, self._protocol.aliases, self._protocol)
        with self._telling_where():
            for record in self._records():
                judged.note(record)
        return judged.verdict()

    def check(self) -> ReplayReport:
        """With the recorded configuration, and a verdict, which takes half as long again."""
        measured = GeometryMeasurement()
        check = EqualityCheck(Codec(self._protocol), observe=measured.tick)
        with beside(self._verdict) as judged:
            self._replay(check.note)
            equality, clock = check.result(), self._clock
            gaps = equality.not_replayed
            self._check_ticks(equality.ticks, equality.ended_ns, gaps[0].why if gaps else "")
            verdict = judged()
        lines = list(report.equality_lines(equality, clock))
        geometry = measured.result()
        values = {
            "geometry": report.values_of(geometry, clock),
            "replay": {"equal": equality.equal, **report.values_of(equality, clock)},
            "verdict": {"holds": verdict.holds, **report.values_of(verdict, clock)},
        }
        overlay = Overlay(lines[0], tuple(lines[:2]))
        lines += report.verdict_lines(verdict, clock)
        if geometry is not None:
            lines.append(
                f"motor speed per km/h in this drive: {geometry.motor_rpm_per_kmh:g} rpm"
                f" ({geometry.samples:,} samples straight on above 10 km/h)"
            )
        return self._report(lines, values, overlay, equality.equal and verdict.holds)

    def open_loop(self, plotted: bool) -> ReplayReport:
        """With the given configuration, on the recorded inputs."""
        configured, codec, series = self._given(plotted)
        loop = OpenLoop(codec, configured.settings, series)
        self._replay(loop.note)
        result, clock = loop.what_if.result(), self._clock
        notes = [_open_loop(result.first_different_command_ns, clock), *self._notes(configured)]
        if loop.reloads:
            notes.append(_reloads(len(loop.reloads), clock.clock(loop.reloads[0])))
        gaps = [NotReplayed(1, at_ns, one.ticks, one.frames, one.why) for at_ns, one in loop.gaps]
        begun = "; from there on it begins with the recorded state"
        notes += [f"{line}{begun}" for line in report.gap_lines(gaps, clock)]
        curves = () if loop.curves is None else loop.curves.result()
        return self._answer(result, notes, series, "open loop", curves)

    def closed_loop(self, plotted: bool) -> ReplayReport:
        """With a simulated vehicle, once with each configuration."""
        configured, codec, series = self._given(plotted)
        loop = ClosedLoop(codec, configured.settings, series)
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

    def _given(self, plotted: bool) -> tuple[GivenConfiguration, Codec, CommandSeries | None]:
        where = str(self._drive.folder / layout.CONFIG_FILE)
        configured = self.changes.configuration(self._drive.info.config, where, self._protocol)
        codec = Codec(dbc.with_aliases(self._protocol, configured.aliases))
        return configured, codec, CommandSeries(codec) if plotted else None

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
        self,
        result: WhatIfResult,
        notes: list[str],
        series: CommandSeries | None,
        loop: str,
        curves: Sequence[CurveUse] = (),
    ) -> ReplayReport:
        clock, names = self._clock, self.changes.names
        self._check_ticks(result.ticks, result.ended_ns)
        given = [f"what if: {', '.join(names)}"] if names else []
        lines = [*given, *notes, "", *report.what_if_lines(result, clock)]
        lines += report.curve_lines(curves)
        what_if = {"loop": loop, "given": given, "notes": notes, "same": result.same}
        what_if["curves"] = report.values_of(tuple(curves), clock)
        values = {"what_if": what_if | report.values_of(result, clock)}
        open_loop = loop == "open loop"
        overlay = report.overlay_of(result, clock, [*given, *notes], series, open_loop, curves)
        return self._report(lines, values, overlay, result.same)

    def _notes(self, configured: GivenConfiguration) -> Iterator[str]:
        yield from configured.without_effect
        written = self._drive.info.versions.get("gateway", "unknown")
        if written != __version__:
            yield (
                f"recorded by vcu-gateway {written}, replayed by {__version__}: see without -c and"
                " --set whether both decide the same"
            )

    def _report(
        self, lines: list[str], values: dict[str, Any], overlay: Overlay, same: bool
    ) -> ReplayReport:
        """The answer behind what the recording is, and what a check of it found.

        Exit codes: changed or damaged, else different, else incomplete; the first and the last of
        a chain.
        """
        info, found, folder = self._drive.info, self._checked, self._drive.folder
        first = (
            f"{folder.resolve().name} on {info.channel}, vcu-gateway"
            f" {info.versions.get('gateway', 'unknown')},"
            f" {counted(len(self._drive.segments), 'segment')}"
        )
        checked = f"recording: {recording_check.headline(found)}"
        faults = recording_check.fault_lines(found, _MOST_FAULTS)
        described = {
            "recording": str(folder),
            "run": info.run,
            "channel": info.channel,
            "recorded_by": info.versions,
            "replayed_by": __version__,
            "check": recording_check.values(found),
        }
        exit_code = 0 if same else 1
        if found.is_chained and (same or found.state is RecordingState.CHANGED):
            exit_code = found.exit_code
        lines = [first, checked, *faults, *lines]
        return ReplayReport(str(self._path), lines, described | values, overlay, exit_code)


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
