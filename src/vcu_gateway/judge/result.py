"""Verdict: violations, reaction times and what was judged, for people and machines."""

from collections import Counter
from collections.abc import Iterable, Sized
from typing import NamedTuple

from vcu_gateway.judge.causes import Seen
from vcu_gateway.judge.wire import MS

_KEPT_EACH = 5


class Violation(NamedTuple):
    """Rule of docs/safety.md that a tick breaks.

    Attributes:
        rule: short and stable, such as "I3 throttle slew".
        tick: number of the tick; at_ns: its time on the gateway's clock.
        sentence: what was seen, with figures.
    """

    rule: str
    tick: int
    at_ns: int
    sentence: str


class ReactionTime(NamedTuple):
    """Times from a cause to the command that obeys it.

    Attributes:
        cause, effect: as in docs/safety.md.
        times: how often it was seen.
        longest_ms: the longest; bound_ms: what that one was allowed, its tick's lateness included.
        tick: of the longest.
    """

    cause: str
    effect: str
    times: int
    longest_ms: float
    bound_ms: float
    tick: int


class DriveVerdict(NamedTuple):
    """Judgement of a whole recording, with the names and the order of the verb's JSON.

    Attributes:
        ticks, commands: how many were judged.
        with_torque: commands with throttle or brake.
        violations_by_rule: how many; violations: the first of each rule.
        reactions: by cause and effect.
        not_judged: what the recording does not show, as sentences.
    """

    ticks: int
    commands: int
    with_torque: int
    longest_between_ticks_ms: float
    violations_by_rule: dict[str, int]
    violations: tuple[Violation, ...]
    reactions: tuple[ReactionTime, ...]
    not_judged: tuple[str, ...]

    @property
    def holds(self) -> bool:
        """True where nothing was broken."""
        return not self.violations_by_rule


class Findings:
    """Violations so far, the first of each rule kept, and reaction times."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()
        self.kept: list[Violation] = []
        self._reactions: dict[tuple[str, str], ReactionTime] = {}

    def broken(self, rule: str, tick: int, at_ns: int, sentence: str) -> None:
        """Count a violation."""
        self.counts[rule] += 1
        if self.counts[rule] <= _KEPT_EACH:
            self.kept.append(Violation(rule, tick, at_ns, sentence))

    def reacted(self, cause: str, effect: str, took_ns: int, bound_ns: int, tick: int) -> None:
        """Count a reaction; the worst against its bound is kept."""
        before = self._reactions.get((cause, effect))
        took_ms, bound_ms = took_ns / MS, bound_ns / MS
        if before is None:
            one = ReactionTime(cause, effect, 1, took_ms, bound_ms, tick)
        elif took_ms - bound_ms > before.longest_ms - before.bound_ms:
            one = ReactionTime(cause, effect, before.times + 1, took_ms, bound_ms, tick)
        else:
            one = before._replace(times=before.times + 1)
        self._reactions[cause, effect] = one

    @property
    def reactions(self) -> tuple[ReactionTime, ...]:
        """Every cause that was seen, in the order of its first sight."""
        return tuple(self._reactions.values())


_BOUND_NS = 52 * MS
"""docs/safety.md, Reaction times: one period and 2 ms; the tick's lateness is added, and the span
in which the cause may have come where a recording has no better time."""


class Reactions:
    """Causes of the last tick whose command has not been seen on the bus yet."""

    def __init__(self, findings: Findings) -> None:
        self._findings = findings
        self._new: list[Seen] = []
        self._tick, self._now_ns, self._left_ns, self._bound_ns = 0, 0, 0, 0

    def left(self, at_ns: int) -> None:
        """A command of the last tick came back: it was on the bus then."""
        self._left_ns = max(self._left_ns, at_ns)

    def tick(
        self, number: int, now_ns: int, late_ns: int, sent: Sized, new: Iterable[Seen]
    ) -> None:
        """A tick answered these causes with these frames; those of the tick before are settled."""
        self.settle()
        self._new = list(new) if len(sent) else []
        self._tick, self._now_ns, self._left_ns = number, now_ns, now_ns
        self._bound_ns = _BOUND_NS + late_ns

    def settle(self) -> None:
        """Count the reactions of the last tick."""
        for one in self._new:
            took_ns, bound_ns = self._left_ns - one.since_ns, self._bound_ns + one.span_ns
            self._findings.reacted(one.cause, one.effect, took_ns, bound_ns, self._tick)
            if took_ns > bound_ns:
                seen = f"{one.cause}: {took_ns / MS:.1f} ms, at most {bound_ns / MS:.1f}"
                self._findings.broken("reaction time", self._tick, self._now_ns, seen)
        self._new = []
