"""Timelines: causes, modes and limited time of one side, from the events of its ticks."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from vcu_gateway.core.causes import BLOCKING, LIMITING, HeldCause
from vcu_gateway.core.events import Event
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.units import NS_PER_S

_LIMITING = frozenset(effect.value for effect in LIMITING)
_BLOCKING = frozenset(effect.value for effect in BLOCKING)
_LONGEST_STEP_NS = NS_PER_S
_MOST_SPANS = 20_000


class CauseKey(NamedTuple):
    """Cause with one of its effects."""

    cause: str
    subject: str
    effect: str

    def __str__(self) -> str:
        return f"{self.subject} ({self.cause}): {self.effect}"


@dataclass
class ReplayedCause:
    """Time for which a cause counted.

    Attributes:
        detail: its value when it began; ended_ns: None where it still counts at the end.
    """

    key: CauseKey
    detail: str
    began_ns: int
    ended_ns: int | None = None


class Stop(NamedTuple):
    """The end of a drive: ACTIVE was left.

    Attributes:
        mode: the mode after it; reason: that of the change; sentence: of `why`, or empty.
    """

    now_ns: int
    mode: str
    reason: str
    sentence: str


@dataclass
class Timeline:
    """What the ticks of one side told.

    Attributes:
        spans: causes in the order of their beginning, at most 20,000.
        modes: every mode with its first tick's time.
        mode_s: seconds by mode; limited_s, blocked_s: with a cause that limits, stops or cuts.
        effect_s: seconds by effect.
        stops: every end of ACTIVE.
    """

    spans: list[ReplayedCause] = field(default_factory=list)
    modes: list[tuple[int, str]] = field(default_factory=list)
    mode_s: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    effect_s: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    limited_s: float = 0.0
    blocked_s: float = 0.0
    stops: list[Stop] = field(default_factory=list)
    _open: dict[CauseKey, ReplayedCause] = field(default_factory=dict)
    _effects: frozenset[str] = frozenset()
    _mode: str | None = None
    _last_ns: int | None = None

    def begin(self, held: Iterable[HeldCause], mode: Mode, now_ns: int) -> None:
        """A stretch begins with these causes and this mode."""
        self._open.clear()
        for one in held:
            finding = one.finding
            key = CauseKey(finding.cause, finding.subject, finding.effect.value)
            self._start(ReplayedCause(key, finding.detail, now_ns))
        self._effects = frozenset(key.effect for key in self._open)
        self._last_ns = now_ns
        self._change_mode(mode.value, now_ns)

    def end(self, now_ns: int) -> None:
        """The stretch ends; what still counts has no end."""
        for span in self._open.values():
            span.ended_ns = now_ns
        self._open.clear()

    def tick(self, now_ns: int, mode: Mode, events: tuple[Event, ...]) -> bool:
        """Take in a tick; True where it ended ACTIVE."""
        self._count(now_ns)
        left = False
        if events:
            for event in events:
                self._take(event, now_ns)
            self._effects = frozenset(key.effect for key in self._open)
        if mode.value != self._mode:
            left = self._mode == Mode.ACTIVE.value
            if left:
                self.stops.append(Stop(now_ns, mode.value, _reason(events), ""))
            self._change_mode(mode.value, now_ns)
        return left

    def explain_stop(self, sentence: str) -> None:
        """The sentence of `why` for the last stop."""
        if self.stops and not self.stops[-1].sentence:
            self.stops[-1] = self.stops[-1]._replace(sentence=sentence)

    def _count(self, now_ns: int) -> None:
        if self._last_ns is not None and self._mode is not None:
            step_s = min(max(now_ns - self._last_ns, 0), _LONGEST_STEP_NS) / NS_PER_S
            self.mode_s[self._mode] += step_s
            if self._effects:
                self._count_effects(step_s)
        self._last_ns = now_ns

    def _count_effects(self, step_s: float) -> None:
        for effect in self._effects:
            self.effect_s[effect] += step_s
        self.limited_s += step_s if self._effects & _LIMITING else 0.0
        self.blocked_s += step_s if self._effects & _BLOCKING else 0.0

    def _take(self, event: Event, now_ns: int) -> None:
        if event.name == "cause_began":
            self._start(ReplayedCause(_key(event), str(event.fields["detail"]), now_ns))
        elif event.name == "cause_ended":
            span = self._open.pop(_key(event), None)
            if span is not None:
                span.ended_ns = now_ns

    def _start(self, span: ReplayedCause) -> None:
        self._open[span.key] = span
        if len(self.spans) < _MOST_SPANS:
            self.spans.append(span)

    def _change_mode(self, mode: str, now_ns: int) -> None:
        if mode != self._mode:
            self._mode = mode
            self.modes.append((now_ns, mode))


def _key(event: Event) -> CauseKey:
    fields = event.fields
    return CauseKey(str(fields["cause"]), str(fields["subject"]), str(fields["effect"]))


def _reason(events: tuple[Event, ...]) -> str:
    reasons = [event.fields["reason"] for event in events if event.name == "mode_changed"]
    return str(reasons[-1]) if reasons else ""
