"""A check and a verdict as lines for a terminal, and as values for machines."""

from collections.abc import Iterator
from typing import Any

from vcu_gateway.judge import DriveVerdict
from vcu_gateway.replay.equality import Difference, Equality, NotReplayed
from vcu_gateway.replay.tables import counted, duration, number, table
from vcu_gateway.replay.time_of_day import TimeOfDay
from vcu_gateway.units import NS_PER_S

_MOST_FIELDS = 12
_MOST_REACTIONS = 40


def equality_lines(equality: Equality, clock: TimeOfDay) -> Iterator[str]:
    """What was compared, and where it first differs."""
    span_s = (equality.ended_ns - equality.began_ns) / NS_PER_S
    if equality.ticks:
        began, ended = clock.iso(equality.began_ns), clock.clock(equality.ended_ns)
        yield f"from {began} to {ended} UTC, {duration(span_s)}"
    yield from gap_lines(equality.gaps, clock)
    if (bug := equality.ended_by_bug) is not None:
        replayed = "the replay decided" if bug.error is None else f"replayed: {bug.error}"
        yield (
            f"the gateway's process ended by a bug in tick {number(bug.tick)} at"
            f" {clock.clock(bug.now_ns)}; {replayed}"
        )
    word = "equal" if equality.equal else "DIFFERENT"
    yield (
        f"{word}: {number(equality.equal_ticks)} of {counted(equality.ticks, 'tick')} to the byte;"
        f" {counted(equality.frames, 'frame')} in, {counted(equality.answers, 'answer')},"
        f" {counted(equality.sentences, 'sentence')} of why,"
        f" {counted(equality.checkpoints, 'checkpoint')} compared"
    )
    if equality.first is not None:
        yield from _first(equality.first, clock)
        yield "differences by field"
        fields = sorted(equality.counts.items(), key=lambda one: -one[1])
        yield from (f"  {number(count):>8}  {field}" for field, count in fields[:_MOST_FIELDS])
        if len(fields) > _MOST_FIELDS:
            yield f"            and {len(fields) - _MOST_FIELDS} more fields"


def _first(one: Difference, clock: TimeOfDay) -> Iterator[str]:
    yield f"first difference: tick {number(one.tick)} at {clock.clock(one.now_ns)}, {one.field}"
    yield f"  recorded: {one.recorded}"
    yield f"  replayed: {one.replayed}"


def gap_lines(gaps: tuple[NotReplayed, ...], clock: TimeOfDay) -> Iterator[str]:
    """What was not replayed."""
    for gap in gaps:
        ticks = "an unknown number of ticks" if gap.ticks is None else counted(gap.ticks, "tick")
        frames = "" if gap.frames is None else f" and {counted(gap.frames, 'frame')}"
        place = f"after {clock.clock(gap.now_ns)}" if gap.after_tick else "at the beginning"
        yield f"not replayed: {ticks}{frames} {place}: {gap.why}"


def verdict_lines(verdict: DriveVerdict, clock: TimeOfDay) -> Iterator[str]:
    """Violations with their figures, reaction times."""
    word = "holds" if verdict.holds else "BROKEN"
    broken = sum(verdict.counts.values())
    yield (
        f"verdict: {word}; {counted(broken, 'violation')} in"
        f" {counted(verdict.commands, 'command')}, {number(verdict.with_torque)} with torque;"
        f" longest time between two ticks {verdict.latest_tick_ms:.1f} ms"
    )
    for rule, count in sorted(verdict.counts.items(), key=lambda one: -one[1]):
        yield f"  {number(count):>8}  {rule}"
    for one in verdict.violations:
        place = f"tick {number(one.tick)} at {clock.clock(one.at_ns)}"
        yield f"  {place}, {one.rule}: {one.sentence}"
    if verdict.reactions:
        yield "reaction times, from the cause on the bus to the command on the bus"
        rows = [
            (
                f"  {one.cause}",
                one.effect,
                number(one.times),
                f"{one.longest_ms:.1f} ms",
                f"{one.bound_ms:.1f} ms",
            )
            for one in verdict.reactions[:_MOST_REACTIONS]
        ]
        yield from table(("  cause", "effect", "times", "longest", "allowed"), rows, (2, 3, 4))


def equality_values(equality: Equality, clock: TimeOfDay) -> dict[str, Any]:
    """The same for --json."""
    first = equality.first
    return {
        "equal": equality.equal,
        "began": clock.iso(equality.began_ns),
        "ended": clock.iso(equality.ended_ns),
        "ticks": equality.ticks,
        "equal_ticks": equality.equal_ticks,
        "frames": equality.frames,
        "answers": equality.answers,
        "why_sentences": equality.sentences,
        "checkpoints": equality.checkpoints,
        "first_difference": None
        if first is None
        else {
            "tick": first.tick,
            "time": clock.iso(first.now_ns),
            "field": first.field,
            "recorded": first.recorded,
            "replayed": first.replayed,
        },
        "differences": equality.counts,
        "ended_by_bug": None
        if equality.ended_by_bug is None
        else {
            "tick": equality.ended_by_bug.tick,
            "time": clock.iso(equality.ended_by_bug.now_ns),
            "error": equality.ended_by_bug.error,
        },
        "not_replayed": [
            {
                "after_tick": gap.after_tick,
                "time": clock.iso(gap.now_ns),
                "ticks": gap.ticks,
                "frames": gap.frames,
                "why": gap.why,
            }
            for gap in equality.gaps
        ],
    }


def verdict_values(verdict: DriveVerdict, clock: TimeOfDay) -> dict[str, Any]:
    """The same for --json."""
    return {
        "holds": verdict.holds,
        "ticks": verdict.ticks,
        "commands": verdict.commands,
        "with_torque": verdict.with_torque,
        "longest_between_ticks_ms": verdict.latest_tick_ms,
        "violations_by_rule": verdict.counts,
        "violations": [
            {
                "rule": one.rule,
                "tick": one.tick,
                "time": clock.iso(one.at_ns),
                "sentence": one.sentence,
            }
            for one in verdict.violations
        ],
        "reactions": [one._asdict() for one in verdict.reactions],
        "not_judged": list(verdict.not_judged),
    }
