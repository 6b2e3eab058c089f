"""`vcu-gateway replay --html`: the report of a recording with a what-if over it."""

from collections.abc import Sequence

from vcu_gateway.cli.replay_options import ReplayOptions
from vcu_gateway.export.html_report import Overlay, write_report
from vcu_gateway.export.output import written_text
from vcu_gateway.replay.commands import CommandSeries
from vcu_gateway.replay.time_of_day import TimeOfDay
from vcu_gateway.replay.what_if import WhatIfResult
from vcu_gateway.replay.what_if_text import command_table

Drawn = tuple[WhatIfResult, TimeOfDay, CommandSeries | None]
"""What is drawn over the recording, its clock, and the commands at each tick."""


def write_html(
    asked: ReplayOptions,
    name: str,
    notes: Sequence[str],
    headline: str,
    drawn: Drawn | None = None,
    only_changes: bool = False,
) -> None:
    """Write the report of the recording `name` to the file that was asked for.

    `only_changes`: leave out causes that are those of the recording, which the page has anyway.
    """
    if asked.html_path is None:
        return
    overlay = Overlay(headline, tuple(notes))
    if drawn is not None:
        overlay = _drawn(overlay, *drawn, only_changes)
    with written_text(asked.html_path) as out:
        write_report(name, out, overlay)


def _drawn(
    overlay: Overlay,
    result: WhatIfResult,
    clock: TimeOfDay,
    series: CommandSeries | None,
    only_changes: bool,
) -> Overlay:
    columns, rows = command_table(result, clock)
    wall_ns = clock.wall_ns
    shown = result.after.spans
    if only_changes:
        shown = [span for span in shown if span not in result.before.spans]
    causes = [
        (f"{span.key}", wall_ns(span.began_ns), _end_ns(span.ended_ns, clock)) for span in shown
    ]
    overlay = overlay._replace(
        columns=columns,
        rows=tuple(rows),
        modes=[(wall_ns(at_ns), mode) for at_ns, mode in result.after.modes],
        causes=causes,
    )
    if series is None:
        return overlay
    times_ns = [wall_ns(at_ns) for at_ns in series.times_ns]
    return overlay._replace(times_ns=times_ns, series=series.values)


def _end_ns(ended_ns: int | None, clock: TimeOfDay) -> int | None:
    return None if ended_ns is None else clock.wall_ns(ended_ns)
