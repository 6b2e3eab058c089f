"""A what-if as values for --json, and as what a report draws over a drive."""

from typing import Any

from vcu_gateway.drive.cause_spans import CauseSpan
from vcu_gateway.replay.time_of_day import TimeOfDay
from vcu_gateway.replay.timelines import DriveEnd, Timeline
from vcu_gateway.replay.what_if import FieldDifference, WhatIfResult


def what_if_values(result: WhatIfResult, clock: TimeOfDay) -> dict[str, Any]:
    """Everything that differs."""
    return {
        "same": result.same,
        "began": clock.iso(result.began_ns),
        "ended": clock.iso(result.ended_ns),
        "ticks": result.ticks,
        "different_ticks": result.different_ticks,
        "different_mode_ticks": result.mode_ticks,
        "first_different_command": _time(result.first_ns, clock),
        "would_stop": [_stop(one, clock) for one in result.would_stop],
        "would_not_stop": [_stop(one, clock) for one in result.would_not_stop],
        "fields": [_field(one, clock) for one in result.fields],
        "causes": [
            {
                "change": one.kind,
                "before": None if one.before is None else _span(one.before, clock),
                "after": None if one.after is None else _span(one.after, clock),
            }
            for one in result.causes
        ],
        "requests_by_kind": result.answer_counts,
        "requests": [
            {
                "time": clock.iso(one.now_ns),
                "request": one.request,
                "before": one.before,
                "after": one.after,
            }
            for one in result.answers
        ],
        "before": timeline_values(result.before, clock),
        "after": timeline_values(result.after, clock),
    }


def timeline_values(timeline: Timeline, clock: TimeOfDay) -> dict[str, Any]:
    """What one side told."""
    return {
        "modes": [{"time": clock.iso(at_ns), "mode": mode} for at_ns, mode in timeline.modes],
        "causes": [_span(span, clock) for span in timeline.spans],
        "stops": [_stop(one, clock) for one in timeline.stops],
        "mode_s": _rounded(timeline.mode_s),
        "effect_s": _rounded(timeline.effect_s),
        "limited_s": round(timeline.limited_s, 3),
        "blocked_s": round(timeline.blocked_s, 3),
    }


def _rounded(seconds: dict[str, Any]) -> dict[str, float]:
    return {name: round(value, 3) for name, value in seconds.items()}


def _time(at_ns: int | None, clock: TimeOfDay) -> str | None:
    return None if at_ns is None else clock.iso(at_ns)


def _stop(one: DriveEnd, clock: TimeOfDay) -> dict[str, Any]:
    return {
        "time": clock.iso(one.now_ns),
        "mode": one.mode,
        "reason": one.reason,
        "why": one.sentence,
    }


def _span(span: CauseSpan, clock: TimeOfDay) -> dict[str, Any]:
    return {
        **span.key._asdict(),
        "detail": span.detail,
        "began": clock.iso(span.began_ns),
        "ended": _time(span.ended_ns, clock),
    }


def _field(one: FieldDifference, clock: TimeOfDay) -> dict[str, Any]:
    return {
        "controller": one.controller,
        "field": one.field,
        "ticks": one.ticks,
        "first": {
            "time": clock.iso(one.first_ns),
            "before": one.first[0],
            "after": one.first[1],
        },
        "last": clock.iso(one.last_ns),
        "largest": {
            "time": clock.iso(one.largest_ns),
            "before": one.largest[0],
            "after": one.largest[1],
            "difference": round(one.amount, 6),
        },
    }
