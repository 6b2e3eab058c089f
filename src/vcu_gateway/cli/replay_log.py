"""Replay of a foreign log for the command line."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import click

from vcu_gateway.cli.replay_html import write_html
from vcu_gateway.cli.replay_options import ReplayOptions, ReplayReport, progress
from vcu_gateway.config import Config, core_settings
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.settings import Settings
from vcu_gateway.errors import DataError, Problem
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.recording import RecordedFrame, Recording, open_recording
from vcu_gateway.replay import what_if_text
from vcu_gateway.replay.commands import CommandSeries
from vcu_gateway.replay.drive_records import with_aliases
from vcu_gateway.replay.given_settings import given
from vcu_gateway.replay.log_records import LogReplay
from vcu_gateway.replay.time_of_day import TimeOfDay
from vcu_gateway.replay.what_if_values import timeline_values, what_if_values
from vcu_gateway.strict_yaml import file_text
from vcu_gateway.time_window import Window

_DECISIONS = (
    "a log of the bus holds frames alone: these are decisions on them, with a tick every 50 ms from"
    " the first frame on, and no more; nobody recorded when the ticks really were, so no reaction"
    " time is judged"
)
_NO_DEMAND = (
    "no demand is known, so nobody arms: modes up to standby, causes, and what would have stopped"
    " a drive (--demand 30 holds a throttle)"
)


def report(asked: ReplayOptions) -> ReplayReport:
    """Decide on every frame of a log, with one configuration or with two."""
    if asked.closed_loop:
        raise click.BadParameter("a log has no demands to drive with", param_hint="--closed-loop")
    before, after, codec, without_effect = _settings(asked)
    series = None if asked.html_path is None else CommandSeries(codec)
    replay, clock, window = LogReplay(codec, before, after, series), TimeOfDay(0), asked.window
    with open_recording(asked.recording, _problem) as recording:
        for _ in progress(replay.run(_within(recording, window)), recording, asked.quiet):
            pass
        unreadable = recording.problems.unreadable
    if not replay.frames:
        what, remedy = "holds no frame that can be read", "it is empty"
        if not window.open:
            what, remedy = "has nothing of that time that can be read", "all times are UTC"
        raise DataError(Problem(what, asked.recording, remedy))
    result = replay.what_if.result()
    notes = [*_notes(asked, replay, unreadable, clock), *without_effect]
    lines = [f"{asked.recording}: {replay.frames:,} frames, {result.ticks:,} ticks", *notes, ""]
    values: dict[str, Any] = {
        "recording": asked.recording,
        "frames": replay.frames,
        "ticks": result.ticks,
        "notes": notes,
        "decisions": timeline_values(result.after, clock),
    }
    if after is None:
        lines += what_if_text.decision_lines(result.after, clock)
        lines.append(f"at the end: {replay.sentence}")
        values["why"] = replay.sentence
    else:
        lines += [
            f"what if: {', '.join(asked.assignments)}",
            *what_if_text.what_if_lines(result, clock),
        ]
        values["what_if"] = what_if_values(result, clock)
    headline = what_if_text.headline(result, clock)
    write_html(asked, asked.recording, notes, headline, (result, clock, series))
    return ReplayReport(lines, values, 0 if result.same else 1)


def _within(recording: Recording, window: Window) -> Iterator[RecordedFrame]:
    for one in recording:
        if window.holds(one.frame.arrival_ns):
            yield one


def _problem(problem: Problem) -> None:
    click.echo(str(problem), err=True)


def _settings(asked: ReplayOptions) -> tuple[Settings, Settings | None, Codec, tuple[str, ...]]:
    """Both configurations; -c is the first, and --set changes it for the second."""
    protocol = dbc.load(packaged("vcu.dbc"))
    path = asked.config_path
    text = "" if path is None else file_text.read(path)
    if path is None:
        config, aliases = Config(), Config().protocol.aliases
        before = core_settings(config)
    else:
        first = given(text, str(path), (), protocol)
        before, aliases = first.settings, first.aliases
    after: Settings | None = None
    without_effect: tuple[str, ...] = ()
    if asked.assignments:
        second = given(text, str(path or "defaults"), asked.assignments, protocol)
        after, without_effect = second.settings, second.without_effect
        aliases = second.aliases
    held = asked.demand_pct
    codec = Codec(with_aliases(protocol, aliases))
    if held is None:
        return before, after, codec, without_effect
    return _holding(before, held), after and _holding(after, held), codec, without_effect


def _holding(settings: Settings, throttle_pct: float) -> Settings:
    """A demand that never ends, armed by itself."""
    demand = ControllerDemand(throttle_pct=throttle_pct, power_mode=PowerMode.NORMAL)
    return dataclasses.replace(settings, bench_demand=demand, auto_arm=True)


def _notes(
    asked: ReplayOptions, replay: LogReplay, unreadable: int, clock: TimeOfDay
) -> Iterator[str]:
    yield _DECISIONS
    if asked.demand_pct is None:
        yield _NO_DEMAND
    else:
        yield (
            f"a throttle of {asked.demand_pct:g} % is held from standby on, armed once; the"
            " recorded vehicle does not react to it"
        )
    if replay.commands:
        yield (
            f"{replay.commands:,} recorded commands of a gateway count as what the controllers were"
            " told; they are not compared"
        )
    if unreadable:
        yield f"{unreadable:,} lines or frames could not be read"
    if replay.backwards:
        yield f"{replay.backwards:,} frames are stamped before the frame in front of them"
    for began_ns, ended_ns in replay.pauses[:10]:
        yield (
            f"not replayed: from {clock.clock(began_ns)} to {clock.clock(ended_ns)} there is no"
            " frame; everything begins anew"
        )
