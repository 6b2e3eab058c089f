"""A what-if as lines for a terminal."""

from collections.abc import Iterator

from vcu_gateway.drive.cause_spans import CauseSpan
from vcu_gateway.replay.tables import counted, duration, number, table
from vcu_gateway.replay.time_of_day import TimeOfDay
from vcu_gateway.replay.timelines import DriveEnd, Timeline
from vcu_gateway.replay.what_if import CauseChange, FieldDifference, WhatIfResult

_MOST_ROWS = 30
_MODES = ("starting", "standby", "active", "fault", "stopping")


def headline(result: WhatIfResult, clock: TimeOfDay) -> str:
    """The most important part in one sentence."""
    if result.same:
        return f"nothing differs in {counted(result.ticks, 'tick')}"
    if result.would_stop:
        return f"would have stopped at {_stop(result.would_stop[0], clock)}"
    if result.would_not_stop:
        return f"would not have stopped at {_stop(result.would_not_stop[0], clock)}"
    share = f"{number(result.different_ticks)} of {counted(result.ticks, 'tick')} differ"
    first = "" if result.first_ns is None else f", the first at {clock.clock(result.first_ns)}"
    return share + first


def what_if_lines(result: WhatIfResult, clock: TimeOfDay) -> Iterator[str]:
    """Stops, commands, causes, seconds, answers."""
    ticks = f"{number(result.different_ticks)} of {counted(result.ticks, 'tick')}"
    mode = f", {number(result.mode_ticks)} in their mode" if result.mode_ticks else ""
    first = "" if result.first_ns is None else f"; first at {clock.clock(result.first_ns)}"
    yield f"{ticks} differ{mode}{first}" if not result.same else headline(result, clock)
    for one in result.would_stop[:_MOST_ROWS]:
        yield f"would have stopped at {_stop(one, clock)}"
    for one in result.would_not_stop[:_MOST_ROWS]:
        yield f"would not have stopped at {_stop(one, clock)}"
    if result.fields:
        yield ""
        yield from table(*command_table(result, clock), (2,))
    if result.causes:
        yield ""
        yield from _most("causes", [_change(one, clock) for one in result.causes])
    if not result.same:
        yield ""
        yield from seconds_table(result.before, result.after)
    if result.answers:
        yield ""
        yield from _answers(result, clock)


def decision_lines(timeline: Timeline, clock: TimeOfDay) -> Iterator[str]:
    """What one side told: modes, stops, causes and seconds."""
    modes = [f"  {clock.clock(at_ns)}  {mode}" for at_ns, mode in timeline.modes]
    yield from _most("modes", modes)
    for one in timeline.stops[:_MOST_ROWS]:
        yield f"stopped at {_stop(one, clock)}"
    causes = [f"  {_span(span, clock)}" for span in timeline.spans]
    yield from _most("causes", causes) if causes else ("no cause",)
    yield from seconds_table(timeline, None)


def _stop(one: DriveEnd, clock: TimeOfDay) -> str:
    return f"{clock.clock(one.now_ns)}: {one.sentence or f'{one.mode}; {one.reason}'}"


def command_table(
    result: WhatIfResult, clock: TimeOfDay
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows of the commands' fields; what is the same for both controllers is one row."""
    groups: dict[tuple[object, ...], list[str]] = {}
    for one in result.fields:
        groups.setdefault(one[1:], []).append(one.controller)
    head = ("command", "field", "ticks", "first", "before -> after", "largest", "before -> after")
    rows: list[tuple[str, ...]] = []
    for key, controllers in groups.items():
        one = FieldDifference(", ".join(sorted(controllers)), *key)  # type: ignore[arg-type]
        rows.append(
            (
                one.controller,
                one.field,
                number(one.ticks),
                clock.clock(one.first_ns),
                " -> ".join(one.first),
                clock.clock(one.largest_ns),
                " -> ".join(one.largest),
            )
        )
    return head, rows


def _most(what: str, lines: list[str]) -> Iterator[str]:
    yield what
    yield from lines[:_MOST_ROWS]
    if len(lines) > _MOST_ROWS:
        yield f"  and {len(lines) - _MOST_ROWS} more; --json has all"


def _change(one: CauseChange, clock: TimeOfDay) -> str:
    if one.before is not None and one.after is not None:
        moved = f"{_times(one.before, clock)} -> {_times(one.after, clock)}"
        return f"  moves     {moved}  {one.after.key}{_detail(one.after)}"
    spans = [_span(span, clock) for span in (one.before, one.after) if span is not None]
    return f"  {one.kind:<9} {spans[0]}"


def _span(span: CauseSpan, clock: TimeOfDay) -> str:
    return f"{_times(span, clock)}  {span.key}{_detail(span)}"


def _times(span: CauseSpan, clock: TimeOfDay) -> str:
    ended = "the end" if span.ended_ns is None else clock.clock(span.ended_ns)
    return f"{clock.clock(span.began_ns)} to {ended}"


def _detail(span: CauseSpan) -> str:
    return f" ({span.detail})" if span.detail else ""


def seconds_rows(before: Timeline, after: Timeline) -> list[tuple[str, float, float]]:
    """Seconds in each mode and with each effect, of both sides."""
    rows = [(f"in {mode}", before.mode_s[mode], after.mode_s[mode]) for mode in _MODES]
    rows += [
        ("limited", before.limited_s, after.limited_s),
        ("blocked", before.blocked_s, after.blocked_s),
    ]
    effects = sorted({*before.effect_s, *after.effect_s})
    rows += [(f"with {one}", before.effect_s[one], after.effect_s[one]) for one in effects]
    return [row for row in rows if row[1] or row[2]]


def seconds_table(before: Timeline, after: Timeline | None) -> list[str]:
    """The same as a table; of one side where there is one."""
    rows = seconds_rows(before, after or before)
    if after is None:
        cells = [(name, duration(was)) for name, was, _ in rows]
        return table(("time", "lasts"), cells, (1,))
    cells3 = [(name, duration(was), duration(now)) for name, was, now in rows]
    return table(("time", "before", "after"), cells3, (1, 2))


def _answers(result: WhatIfResult, clock: TimeOfDay) -> Iterator[str]:
    counts = ", ".join(f"{name} {number(n)}" for name, n in result.answer_counts.items())
    lines = [
        f"  {clock.clock(one.now_ns)}  {one.request}: {one.before} -> {one.after}"
        for one in result.answers
    ]
    yield from _most(f"requests answered differently: {counts}", lines)
