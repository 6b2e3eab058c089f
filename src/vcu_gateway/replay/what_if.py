"""What-if: ticks of two configurations side by side, and what differs.

    what_if = WhatIf(codec)
    what_if.begin(causes before, causes after, mode, now_ns)
    what_if.tick(now_ns, before, after)              # every tick
    what_if.answer(now_ns, "arm", before, after)     # every request
    what_if.result()

Results have the names and the order of the verb's JSON (`report.values_of`).
"""

from collections import Counter, deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from vcu_gateway.core.causes import BLOCKING, LIMITING, Event, HeldCause
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import RequestResult
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.recording.core_lines import TickRecord
from vcu_gateway.recording.reader import CauseKey, CauseSpan, CauseSpans
from vcu_gateway.replay.commands import CommandSeries, FieldChange, answer_text, field_changes
from vcu_gateway.units import NS_PER_S

_MOST_ANSWERS = 200
_LIMITING = frozenset(effect.value for effect in LIMITING)
_BLOCKING = frozenset(effect.value for effect in BLOCKING)
_LONGEST_STEP_NS = NS_PER_S
_MOST_SPANS = 20_000


class DriveEnd(NamedTuple):
    """The end of a drive: ACTIVE was left.

    Attributes:
        mode: the mode after it; reason: that of the change; why: its sentence, or empty.
    """

    now_ns: int
    mode: str
    reason: str
    why: str


@dataclass
class Timeline:
    """Causes, modes and limited time of one side, from the events of its ticks.

    Attributes:
        modes: every mode with its first tick's time.
        mode_s: seconds in each mode; effect_s: with each effect that there was.
        limited_s, blocked_s: seconds with a cause that limits, that stops or cuts.
        stops: every end of ACTIVE.
    """

    modes: list[tuple[int, str]] = field(default_factory=list)
    mode_s: dict[str, float] = field(default_factory=lambda: {mode.value: 0.0 for mode in Mode})
    effect_s: dict[str, float] = field(default_factory=dict)
    limited_s: float = 0.0
    blocked_s: float = 0.0
    stops: list[DriveEnd] = field(default_factory=list)
    _causes: CauseSpans = field(default_factory=lambda: CauseSpans(_MOST_SPANS))
    _effects: frozenset[str] = frozenset()
    _mode: str | None = None
    _last_ns: int | None = None

    @property
    def spans(self) -> list[CauseSpan]:
        """Causes in the order of their beginning, at most 20,000."""
        return self._causes.spans

    def begin(self, held: Iterable[HeldCause], mode: Mode, now_ns: int) -> None:
        self._causes.stand(held, now_ns)
        self._effects = self._causes.effects
        self._last_ns = now_ns
        self._change_mode(mode.value, now_ns)

    def end(self, now_ns: int) -> None:
        """The stretch ends, and with it every cause."""
        self._causes.end(now_ns)

    def tick(self, now_ns: int, mode: Mode, events: tuple[Event, ...]) -> bool:
        """Take in a tick; True where it ended ACTIVE."""
        self._count(now_ns)
        left = False
        if events:
            for event in events:
                self._causes.event(event.name, event.fields, now_ns)
            self._effects = self._causes.effects
        if mode.value != self._mode:
            left = self._mode == Mode.ACTIVE.value
            if left:
                self.stops.append(DriveEnd(now_ns, mode.value, _reason(events), ""))
            self._change_mode(mode.value, now_ns)
        return left

    def explain_stop(self, sentence: str) -> None:
        """The sentence of `why` for the last stop."""
        if self.stops and not self.stops[-1].why:
            self.stops[-1] = self.stops[-1]._replace(why=sentence)

    def _count(self, now_ns: int) -> None:
        if self._last_ns is not None and self._mode is not None:
            step_s = min(max(now_ns - self._last_ns, 0), _LONGEST_STEP_NS) / NS_PER_S
            self.mode_s[self._mode] += step_s
            if self._effects:
                self._count_effects(step_s)
        self._last_ns = now_ns

    def _count_effects(self, step_s: float) -> None:
        for effect in self._effects:
            self.effect_s[effect] = self.effect_s.get(effect, 0.0) + step_s
        self.limited_s += step_s if self._effects & _LIMITING else 0.0
        self.blocked_s += step_s if self._effects & _BLOCKING else 0.0

    def _change_mode(self, mode: str, now_ns: int) -> None:
        if mode != self._mode:
            self._mode = mode
            self.modes.append((now_ns, mode))


class DifferentTick(NamedTuple):
    """A field at one tick, on both sides."""

    now_ns: int
    before: str
    after: str


class LargestDifference(NamedTuple):
    """The same where both sides are furthest apart; difference: in the field's unit."""

    now_ns: int
    before: str
    after: str
    difference: float


class FieldDifference(NamedTuple):
    """One field of one controller's commands that differs.

    Attributes:
        ticks: how many; first, largest: two of them; last_ns: when the last was.
    """

    controller: str
    field: str
    ticks: int
    first: DifferentTick
    last_ns: int
    largest: LargestDifference


class CauseChange(NamedTuple):
    """A cause that appears, vanishes or moves in time; None on the side without it."""

    change: str
    before: CauseSpan | None
    after: CauseSpan | None


class AnswerChange(NamedTuple):
    """A request that is answered differently."""

    now_ns: int
    request: str
    before: str
    after: str


class WhatIfResult(NamedTuple):
    """What another configuration does differently.

    Attributes:
        began_ns, ended_ns: first and last tick.
        ticks, different_ticks: compared, and with another command or mode.
        different_mode_ticks: ticks with another mode.
        first_different_command_ns: None where all are the same.
        would_stop, would_not_stop: ends of ACTIVE on one side alone.
        fields: by controller and field, the most ticks first.
        causes: changes in the order of time.
        requests_by_kind: how many are answered differently; requests: the first 200.
        before, after: what each side told.
    """

    began_ns: int
    ended_ns: int
    ticks: int
    different_ticks: int
    different_mode_ticks: int
    first_different_command_ns: int | None
    would_stop: tuple[DriveEnd, ...]
    would_not_stop: tuple[DriveEnd, ...]
    fields: tuple[FieldDifference, ...]
    causes: tuple[CauseChange, ...]
    requests_by_kind: dict[str, int]
    requests: tuple[AnswerChange, ...]
    before: Timeline
    after: Timeline

    @property
    def same(self) -> bool:
        return not (self.different_ticks or self.causes or self.requests_by_kind)


class WhatIf:
    """Comparison of both sides, tick by tick; memory grows with differences alone.

    `series`, where there is one, is given the commands of the side after.
    """

    def __init__(self, codec: Codec, series: CommandSeries | None = None) -> None:
        self.before, self.after = Timeline(), Timeline()
        self._series = series
        self._codec = codec
        self._differences: dict[tuple[str, str], FieldDifference] = {}
        self._answers: list[AnswerChange] = []
        self._answer_counts: Counter[str] = Counter()
        self._ticks = self._different_ticks = self._mode_ticks = 0
        self._began_ns: int | None = None
        self._first_ns: int | None = None
        self._now_ns = 0

    def begin(
        self, before: Iterable[HeldCause], after: Iterable[HeldCause], mode: Mode, now_ns: int
    ) -> None:
        """A stretch begins: the causes that each side holds, and the mode of both."""
        self.before.begin(before, mode, now_ns)
        self.after.begin(after, mode, now_ns)

    def gap(self, now_ns: int) -> None:
        self.before.end(now_ns)
        self.after.end(now_ns)

    def tick(
        self, now_ns: int, before: TickRecord | TickResult, after: TickResult
    ) -> tuple[bool, bool]:
        """Compare a tick; whether it ended ACTIVE on each side."""
        self._ticks += 1
        self._now_ns = now_ns
        if self._began_ns is None:
            self._began_ns = now_ns
        different = before.frames != after.frames
        if different:
            if self._first_ns is None:
                self._first_ns = now_ns
            for change in field_changes(self._codec, before.frames, after.frames):
                self._note(change, now_ns)
        if before.mode is not after.mode:
            self._mode_ticks += 1
            different = True
        self._different_ticks += different
        if self._series is not None:
            self._series.add(now_ns, after.frames)
        return (
            self.before.tick(now_ns, before.mode, before.events),
            self.after.tick(now_ns, after.mode, after.events),
        )

    def decided(self, now_ns: int, results: Sequence[TickResult], cores: Sequence[Gateway]) -> None:
        """Compare a tick of two cores, or of one with itself; each explains its own stop."""
        left = self.tick(now_ns, results[0], results[-1])
        for ended, side, core in zip(
            left, (self.before, self.after), (cores[0], cores[-1]), strict=True
        ):
            if ended:
                side.explain_stop(core.why(now_ns).sentence())

    def answer(
        self, now_ns: int, request: str, before: RequestResult, after: RequestResult
    ) -> None:
        """Compare the answers to a request."""
        if before == after:
            return
        self._answer_counts[request] += 1
        if len(self._answers) < _MOST_ANSWERS:
            self._answers.append(
                AnswerChange(now_ns, request, answer_text(before), answer_text(after))
            )

    def _note(self, change: FieldChange, now_ns: int) -> None:
        controller, name, before, after, amount = change
        largest = LargestDifference(now_ns, before, after, round(amount, 6))
        known = self._differences.get((controller, name))
        if known is None:
            first = DifferentTick(now_ns, before, after)
            known = FieldDifference(controller, name, 0, first, now_ns, largest)
        if largest.difference <= known.largest.difference:
            largest = known.largest
        self._differences[controller, name] = known._replace(
            ticks=known.ticks + 1, last_ns=now_ns, largest=largest
        )

    def result(self) -> WhatIfResult:
        before, after = self.before, self.after
        for effect in {*before.effect_s, *after.effect_s}:
            for side in (before, after):
                side.effect_s.setdefault(effect, 0.0)
        return WhatIfResult(
            began_ns=self._began_ns or 0,
            ended_ns=self._now_ns,
            ticks=self._ticks,
            different_ticks=self._different_ticks,
            different_mode_ticks=self._mode_ticks,
            first_different_command_ns=self._first_ns,
            would_stop=_alone(after.stops, before.stops),
            would_not_stop=_alone(before.stops, after.stops),
            fields=tuple(sorted(self._differences.values(), key=lambda one: -one.ticks)),
            causes=tuple(cause_changes(before.spans, after.spans)),
            requests_by_kind=dict(self._answer_counts),
            requests=tuple(self._answers),
            before=before,
            after=after,
        )


def _alone(stops: list[DriveEnd], others: list[DriveEnd]) -> tuple[DriveEnd, ...]:
    """Stops at a tick at which the other side has none of the same mode."""
    known = {(one.now_ns, one.mode) for one in others}
    return tuple(one for one in stops if (one.now_ns, one.mode) not in known)


def cause_changes(before: list[CauseSpan], after: list[CauseSpan]) -> list[CauseChange]:
    """Spans that differ; those of one cause that overlap are the same cause at another time."""
    others: dict[CauseKey, deque[CauseSpan]] = {}
    for span in after:
        others.setdefault(span.key, deque()).append(span)
    changes = []
    for was in before:
        waiting = others.get(was.key, deque())
        while waiting and _ends_before(waiting[0], was):
            changes.append(CauseChange("appears", None, waiting.popleft()))
        if not waiting or _ends_before(was, waiting[0]):
            changes.append(CauseChange("vanishes", was, None))
            continue
        now = waiting.popleft()
        if (was.began_ns, was.ended_ns) != (now.began_ns, now.ended_ns):
            changes.append(CauseChange("moves", was, now))
    left = [span for waiting in others.values() for span in waiting]
    changes += [CauseChange("appears", None, span) for span in left]
    return sorted(changes, key=_began_ns)


def _ends_before(one: CauseSpan, other: CauseSpan) -> bool:
    return one.ended_ns is not None and one.ended_ns <= other.began_ns


def _began_ns(change: CauseChange) -> int:
    return min(span.began_ns for span in change[1:] if isinstance(span, CauseSpan))


def _reason(events: tuple[Event, ...]) -> str:
    reasons = [event.fields["reason"] for event in events if event.name == "mode_changed"]
    return str(reasons[-1]) if reasons else ""
