"""What-if: ticks of two configurations side by side, and what differs.

what_if = WhatIf(codec)
what_if.begin(gateway before, gateway after, now_ns)
what_if.tick(number, now_ns, before, after)      # every tick
what_if.answer(now_ns, "arm", before, after)     # every request
what_if.result()
"""

from collections import Counter, deque
from collections.abc import Iterable
from typing import NamedTuple, Protocol

from vcu_gateway.core.causes import HeldCause
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import RequestResult
from vcu_gateway.core.events import Event
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.drive.cause_spans import CauseKey, CauseSpan
from vcu_gateway.replay.commands import CommandFields, FieldChange, answer_text
from vcu_gateway.replay.timelines import DriveEnd, Timeline

_MOST_ANSWERS = 200


class TickOutcome(Protocol):
    """What a tick told, recorded or replayed."""

    @property
    def frames(self) -> tuple[OutFrame, ...]:
        """Commands of both controllers; none while listening."""

    @property
    def mode(self) -> Mode:
        """Mode after the tick."""

    @property
    def events(self) -> tuple[Event, ...]:
        """Events since the tick before."""


class FieldDifference(NamedTuple):
    """One field of one controller's commands that differs.

    Attributes:
        ticks: how many; first_ns, last_ns: the first and the last of them.
        first, largest: before and after, then; largest_ns: when.
        amount: of the largest, in the field's unit.
    """

    controller: str
    field: str
    ticks: int
    first_ns: int
    first: tuple[str, str]
    last_ns: int
    largest_ns: int
    largest: tuple[str, str]
    amount: float


class CauseChange(NamedTuple):
    """A cause that appears, vanishes or counts at another time; None on the side without it."""

    kind: str
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
        ticks, different_ticks: compared, and with another command or mode.
        began_ns, ended_ns: first and last tick.
        first_ns: the first tick with another command; None where all are the same.
        mode_ticks: ticks with another mode.
        fields: by controller and field, the most ticks first.
        causes: changes in the order of time.
        answers: the first 200; answer_counts: all, by request.
        would_stop, would_not_stop: ends of ACTIVE on one side alone.
        before, after: what each side told.
    """

    ticks: int
    different_ticks: int
    began_ns: int
    ended_ns: int
    first_ns: int | None
    mode_ticks: int
    fields: tuple[FieldDifference, ...]
    causes: tuple[CauseChange, ...]
    answers: tuple[AnswerChange, ...]
    answer_counts: dict[str, int]
    would_stop: tuple[DriveEnd, ...]
    would_not_stop: tuple[DriveEnd, ...]
    before: Timeline
    after: Timeline

    @property
    def same(self) -> bool:
        """True where nothing differs."""
        return not (self.different_ticks or self.causes or self.answer_counts)


class WhatIf:
    """Comparison of both sides, tick by tick; memory grows with differences alone."""

    def __init__(self, codec: Codec) -> None:
        self.before, self.after = Timeline(), Timeline()
        self._fields = CommandFields(codec)
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
        """A stretch begins: the causes that each side holds."""
        self.before.begin(before, mode, now_ns)
        self.after.begin(after, mode, now_ns)

    def gap(self, now_ns: int) -> None:
        """What follows is not recorded."""
        self.before.end(now_ns)
        self.after.end(now_ns)

    def tick(self, now_ns: int, before: TickOutcome, after: TickOutcome) -> tuple[bool, bool]:
        """Compare a tick; whether it ended ACTIVE on each side."""
        self._ticks += 1
        self._now_ns = now_ns
        if self._began_ns is None:
            self._began_ns = now_ns
        different = before.frames != after.frames
        if different:
            if self._first_ns is None:
                self._first_ns = now_ns
            for change in self._fields.changes(before.frames, after.frames):
                self._note(change, now_ns)
        if before.mode is not after.mode:
            self._mode_ticks += 1
            different = True
        self._different_ticks += different
        return (
            self.before.tick(now_ns, before.mode, before.events),
            self.after.tick(now_ns, after.mode, after.events),
        )

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
        key, values = (change.controller, change.field), (change.before, change.after)
        known = self._differences.get(key)
        if known is None:
            self._differences[key] = FieldDifference(
                *key, 1, now_ns, values, now_ns, now_ns, values, change.amount
            )
            return
        known = known._replace(ticks=known.ticks + 1, last_ns=now_ns)
        if change.amount > known.amount:
            known = known._replace(largest_ns=now_ns, largest=values, amount=change.amount)
        self._differences[key] = known

    def result(self) -> WhatIfResult:
        """Everything that differs."""
        before, after = self.before, self.after
        fields = sorted(self._differences.values(), key=lambda one: -one.ticks)
        return WhatIfResult(
            ticks=self._ticks,
            different_ticks=self._different_ticks,
            began_ns=self._began_ns or 0,
            ended_ns=self._now_ns,
            first_ns=self._first_ns,
            mode_ticks=self._mode_ticks,
            fields=tuple(fields),
            causes=tuple(cause_changes(before.spans, after.spans)),
            answers=tuple(self._answers),
            answer_counts=dict(self._answer_counts),
            would_stop=_alone(after.stops, before.stops),
            would_not_stop=_alone(before.stops, after.stops),
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
