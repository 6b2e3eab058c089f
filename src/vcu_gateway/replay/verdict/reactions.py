"""Reaction times: from a cause's frame, or its deadline, to the command that left after it."""

from collections.abc import Iterable, Sized

from vcu_gateway.replay.verdict.expected_effects import Seen
from vcu_gateway.replay.verdict.result import Findings
from vcu_gateway.replay.verdict.wire import MS

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
