"""Results of a replay: as lines for a terminal, as values for JSON, and drawn over a recording."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway import text
from vcu_gateway.core.tuning import DERATINGS, LIMITS
from vcu_gateway.export.curve_figure import CurveFigure
from vcu_gateway.export.formats import written_text
from vcu_gateway.export.html_report import write_report
from vcu_gateway.export.report import Overlay
from vcu_gateway.judge.result import DriveVerdict
from vcu_gateway.recording.reader import CauseSpan
from vcu_gateway.replay.commands import CommandSeries
from vcu_gateway.replay.curve_use import CurveUse
from vcu_gateway.replay.equality import Equality, NotReplayed
from vcu_gateway.replay.what_if import (
    CauseChange,
    DriveEnd,
    FieldDifference,
    Timeline,
    WhatIfResult,
)
from vcu_gateway.text import counted
from vcu_gateway.units import NS_PER_MS

_MOST_FIELDS = 12
_MOST_REACTIONS = 40
_MOST_ROWS = 30


class ReplayReport(NamedTuple):
    """Answer of a replay, in each of its forms.

    Attributes:
        recording: its path, which the page is made of.
        values: for JSON; overlay: what the page shows over the recording.
        exit_code: 0 where nothing differs and the recording is whole, else as the verb's.
    """

    recording: str
    lines: list[str]
    values: dict[str, Any]
    overlay: Overlay
    exit_code: int

    def write_html(self, path: Path) -> None:
        """Write one page with plots; an old file is replaced, UnavailableError where it cannot."""
        with written_text(path) as out:
            write_report(self.recording, out, self.overlay)


class TimeOfDay:
    """Clock of a drive: wall time is monotonic time and `distance_ns`; as text in UTC."""

    def __init__(self, distance_ns: int) -> None:
        self._distance_ns = distance_ns

    def wall_ns(self, now_ns: int) -> int:
        return now_ns + self._distance_ns

    def clock(self, now_ns: int) -> str:
        """Time of day, as 12:03:14.150."""
        return text.utc(self.wall_ns(now_ns), text.TIME_OF_DAY_MS)

    def iso(self, now_ns: int) -> str:
        """Date and time, as 2026-11-23T12:03:14.150Z."""
        return text.utc(self.wall_ns(now_ns), text.ISO_TIME_MS)


def values_of(one: object, clock: TimeOfDay) -> Any:
    """A result as JSON: its fields by name, instants (`began_ns`) as dates in UTC (`began`)."""
    if isinstance(one, CauseSpan):
        span = {"began_ns": one.began_ns, "ended_ns": one.ended_ns}
        return {**one.key._asdict(), "detail": one.detail, **_fields(span, clock)}
    if isinstance(one, Timeline):
        return _timeline_values(one, clock)
    if isinstance(one, tuple) and hasattr(one, "_asdict"):
        return _fields(one._asdict(), clock)
    return [values_of(each, clock) for each in one] if isinstance(one, tuple | list) else one


def _fields(fields: dict[str, Any], clock: TimeOfDay) -> dict[str, Any]:
    values = {}
    for name, value in fields.items():
        if name.endswith("_ns"):
            key = "time" if name in ("now_ns", "at_ns") else name.removesuffix("_ns")
            values[key] = None if value is None else clock.iso(value)
        else:
            values[name] = values_of(value, clock)
    return values


def _timeline_values(one: Timeline, clock: TimeOfDay) -> dict[str, Any]:
    return {
        "modes": [{"time": clock.iso(at_ns), "mode": mode} for at_ns, mode in one.modes],
        "causes": values_of(one.spans, clock),
        "stops": values_of(one.stops, clock),
        "mode_s": {mode: round(seconds, 3) for mode, seconds in one.mode_s.items()},
        "effect_s": {effect: round(seconds, 3) for effect, seconds in one.effect_s.items()},
        "limited_s": round(one.limited_s, 3),
        "blocked_s": round(one.blocked_s, 3),
    }


def equality_lines(equality: Equality, clock: TimeOfDay) -> Iterator[str]:
    """Sentences on what was compared, and where it first differs."""
    if equality.ticks:
        began, ended = clock.iso(equality.began_ns), clock.clock(equality.ended_ns)
        lasted = text.duration((equality.ended_ns - equality.began_ns) / NS_PER_MS)
        yield f"from {began} to {ended} UTC, {lasted}"
    yield from gap_lines(equality.not_replayed, clock)
    if (bug := equality.ended_by_bug) is not None:
        replayed = "the replay decided" if bug.error is None else f"replayed: {bug.error}"
        yield (
            f"the gateway's process ended by a bug in tick {bug.tick:,} at"
            f" {clock.clock(bug.now_ns)}; {replayed}"
        )
    word = "equal" if equality.equal else "DIFFERENT"
    yield (
        f"{word}: {equality.equal_ticks:,} of {counted(equality.ticks, 'tick')} to the byte;"
        f" {counted(equality.frames, 'frame')} in, {counted(equality.answers, 'answer')},"
        f" {counted(equality.why_sentences, 'sentence')} of why,"
        f" {counted(equality.checkpoints, 'checkpoint')} compared"
    )
    if (first := equality.first_difference) is not None:
        yield f"first difference: tick {first.tick:,} at {clock.clock(first.now_ns)}, {first.field}"
        yield f"  recorded: {first.recorded}"
        yield f"  replayed: {first.replayed}"
        yield "differences by field"
        fields = _by_count(equality.differences)
        yield from fields[:_MOST_FIELDS]
        if len(fields) > _MOST_FIELDS:
            yield f"            and {len(fields) - _MOST_FIELDS} more fields"


def gap_lines(gaps: Iterable[NotReplayed], clock: TimeOfDay) -> Iterator[str]:
    """A sentence on each stretch that was not replayed."""
    for gap in gaps:
        ticks = "an unknown number of ticks" if gap.ticks is None else counted(gap.ticks, "tick")
        frames = "" if gap.frames is None else f" and {counted(gap.frames, 'frame')}"
        place = f"after {clock.clock(gap.now_ns)}" if gap.after_tick else "at the beginning"
        yield f"not replayed: {ticks}{frames} {place}: {gap.why}"


def verdict_lines(verdict: DriveVerdict, clock: TimeOfDay) -> Iterator[str]:
    """Violations with their figures, and reaction times."""
    word = "holds" if verdict.holds else "BROKEN"
    yield (
        f"verdict: {word}; {counted(sum(verdict.violations_by_rule.values()), 'violation')} in"
        f" {counted(verdict.commands, 'command')}, {verdict.with_torque:,} with torque;"
        f" longest time between two ticks {verdict.longest_between_ticks_ms:.1f} ms"
    )
    yield from _by_count(verdict.violations_by_rule)
    for one in verdict.violations:
        yield f"  tick {one.tick:,} at {clock.clock(one.at_ns)}, {one.rule}: {one.sentence}"
    if verdict.reactions:
        yield "reaction times, from the cause on the bus to the command on the bus"
        head = ("cause", "effect", "times", "longest", "allowed")
        rows = [
            (cause, effect, f"{times:,}", f"{longest_ms:.1f} ms", f"{bound_ms:.1f} ms")
            for cause, effect, times, longest_ms, bound_ms, _ in verdict.reactions
        ]
        yield from text.table([head, *rows[:_MOST_REACTIONS]], (2, 3, 4), "  ")


def _by_count(counts: dict[str, int]) -> list[str]:
    """A line for each name, the most frequent first."""
    ordered = sorted(counts.items(), key=lambda one: -one[1])
    return [f"  {count:>8,}  {name}" for name, count in ordered]


def headline(result: WhatIfResult, clock: TimeOfDay) -> str:
    """The most important part in one sentence."""
    if result.same:
        return f"nothing differs in {counted(result.ticks, 'tick')}"
    if result.would_stop:
        return f"would have stopped at {_stop(result.would_stop[0], clock)}"
    if result.would_not_stop:
        return f"would not have stopped at {_stop(result.would_not_stop[0], clock)}"
    return _different_ticks(result) + _first(result, clock, ", the first")


def what_if_lines(result: WhatIfResult, clock: TimeOfDay) -> Iterator[str]:
    """Stops, commands, causes, seconds and answers that differ."""
    if result.same:
        yield headline(result, clock)
        return
    mode_ticks = result.different_mode_ticks
    mode = f", {mode_ticks:,} in their mode" if mode_ticks else ""
    yield f"{_different_ticks(result)}{mode}{_first(result, clock, '; first')}"
    for one in result.would_stop[:_MOST_ROWS]:
        yield f"would have stopped at {_stop(one, clock)}"
    for one in result.would_not_stop[:_MOST_ROWS]:
        yield f"would not have stopped at {_stop(one, clock)}"
    if result.fields:
        yield from ("", *text.table(_command_table(result, clock), (2,)))
    if result.causes:
        yield from ("", *_most("causes", [_change(one, clock) for one in result.causes]))
    yield from ("", *_seconds_table({"before": result.before, "after": result.after}))
    if result.requests:
        counts = ", ".join(f"{name} {count:,}" for name, count in result.requests_by_kind.items())
        answers = [
            f"{clock.clock(at_ns)}  {request}: {before} -> {after}"
            for at_ns, request, before, after in result.requests
        ]
        yield from ("", *_most(f"requests answered differently: {counts}", answers))


def decision_lines(timeline: Timeline, clock: TimeOfDay) -> Iterator[str]:
    """Modes, stops, causes and seconds of one side."""
    yield from _most("modes", [f"{clock.clock(at_ns)}  {mode}" for at_ns, mode in timeline.modes])
    for one in timeline.stops[:_MOST_ROWS]:
        yield f"stopped at {_stop(one, clock)}"
    causes = [_span(span, clock) for span in timeline.spans]
    yield from _most("causes", causes) if causes else ("no cause",)
    yield from _seconds_table({"lasts": timeline})


def curve_lines(curves: Sequence[CurveUse]) -> Iterator[str]:
    """Where the drive was on each curve, how long that limited and how far down, on both sides."""
    if not curves:
        return
    rows = [("curve", "input", "limited", "lowest")]
    for one in curves:
        derating = DERATINGS[one.key.removeprefix("curves.")]
        places = [x for x, _ in one.seconds_at]
        unit = derating.input.quantity.unit
        span = f"{places[0]:g} to {places[-1]:g} {unit}" if places else "not known"
        if places and one.unknown_s:
            span += f", not known {text.duration(one.unknown_s * 1000)}"
        sides = (one.before, one.after)
        limited = _arrow(text.duration(side.limited_s * 1000) for side in sides)
        cap = LIMITS[derating.limit].unit
        lowest = _arrow(
            "none" if one.lowest is None else f"{one.lowest:.0f} {cap}" for one in sides
        )
        rows.append((derating.name, span, limited, lowest))
    yield from ("", *text.table(rows))


def _arrow(sides: Iterable[str]) -> str:
    before, after = sides
    return before if before == after else f"{before} -> {after}"


def _different_ticks(result: WhatIfResult) -> str:
    return f"{result.different_ticks:,} of {counted(result.ticks, 'tick')} differ"


def _first(result: WhatIfResult, clock: TimeOfDay, words: str) -> str:
    first_ns = result.first_different_command_ns
    return "" if first_ns is None else f"{words} at {clock.clock(first_ns)}"


def _stop(one: DriveEnd, clock: TimeOfDay) -> str:
    return f"{clock.clock(one.now_ns)}: {one.why or f'{one.mode}; {one.reason}'}"


def _most(what: str, lines: Sequence[str]) -> Iterator[str]:
    yield what
    yield from (f"  {line}" for line in lines[:_MOST_ROWS])
    if len(lines) > _MOST_ROWS:
        yield f"  and {len(lines) - _MOST_ROWS} more; --json has all"


def _change(one: CauseChange, clock: TimeOfDay) -> str:
    spans = [span for span in (one.before, one.after) if span is not None]
    before = f"{_times(spans[0], clock)} -> " if len(spans) == 2 else ""
    return f"{one.change:<9} {before}{_span(spans[-1], clock)}"


def _span(span: CauseSpan, clock: TimeOfDay) -> str:
    detail = f" ({span.detail})" if span.detail else ""
    return f"{_times(span, clock)}  {span.key}{detail}"


def _times(span: CauseSpan, clock: TimeOfDay) -> str:
    ended = "the end" if span.ended_ns is None else clock.clock(span.ended_ns)
    return f"{clock.clock(span.began_ns)} to {ended}"


def _command_table(result: WhatIfResult, clock: TimeOfDay) -> list[tuple[str, ...]]:
    """Head and rows of the commands' fields; what is the same for both controllers is one row."""
    groups: dict[FieldDifference, list[str]] = {}
    for one in result.fields:
        groups.setdefault(one._replace(controller=""), []).append(one.controller)
    rows: list[tuple[str, ...]] = [
        ("command", "field", "ticks", "first", "before -> after", "largest", "before -> after")
    ]
    for one, controllers in groups.items():
        cells = [", ".join(sorted(controllers)), one.field, f"{one.ticks:,}"]
        for at in (one.first, one.largest):
            cells += [clock.clock(at.now_ns), f"{at.before} -> {at.after}"]
        rows.append(tuple(cells))
    return rows


def _seconds_table(sides: dict[str, Timeline]) -> list[str]:
    """Seconds in each mode and with each effect, a column for each side."""
    columns = []
    for one in sides.values():
        seconds = {f"in {mode}": mode_s for mode, mode_s in one.mode_s.items()}
        seconds |= {"limited": one.limited_s, "blocked": one.blocked_s}
        columns.append(
            seconds | {f"with {name}": one.effect_s[name] for name in sorted(one.effect_s)}
        )
    rows = [
        (
            name,
            *(text.duration(column[name] * 1000) if column[name] else "0 s" for column in columns),
        )
        for name in columns[0]
        if any(column[name] for column in columns)
    ]
    return text.table([("time", *sides), *rows], (1, 2))


def overlay_of(
    result: WhatIfResult,
    clock: TimeOfDay,
    notes: Iterable[str],
    series: CommandSeries | None,
    only_changes: bool = False,
    curves: Sequence[CurveUse] = (),
) -> Overlay:
    """The replayed side over a recording.

    `only_changes`: leave out causes that are those of the recording, which the page has anyway.
    """
    table, wall_ns = _command_table(result, clock), clock.wall_ns
    shown = result.after.spans
    if only_changes:
        shown = [span for span in shown if span not in result.before.spans]
    return Overlay(
        headline=headline(result, clock),
        notes=tuple(notes),
        columns=table[0],
        rows=tuple(table[1:]),
        modes=[(wall_ns(at_ns), mode) for at_ns, mode in result.after.modes],
        causes=[
            (str(one.key), wall_ns(one.began_ns), one.ended_ns and wall_ns(one.ended_ns))
            for one in shown
        ],
        times_ns=[] if series is None else [wall_ns(at_ns) for at_ns in series.times_ns],
        series={} if series is None else series.values,
        curves=[_figure(one) for one in curves],
    )


def _figure(one: CurveUse) -> CurveFigure:
    derating = DERATINGS[one.key.removeprefix("curves.")]
    return CurveFigure(
        derating.name,
        derating.input.quantity.unit,
        LIMITS[derating.limit].unit,
        one.before.points or (),
        one.after.points or (),
        one.seconds_at,
    )
