"""Timelines: causes, modes and limited time of one side, from the events of its ticks."""

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import NamedTuple

from vcu_gateway.core.causes import BLOCKING, LIMITING, HeldCause
from vcu_gateway.core.events import Event
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.drive.cause_spans import CauseSpan, CauseSpans
from vcu_gateway.units import NS_PER_S

_LIMITING = frozenset(effect.value for effect in LIMITING)
_BLOCKING = frozenset(effect.value for effect in BLOCKING)
_LONGEST_STEP_NS = NS_PER_S
_MOST_SPANS = 20_000


class DriveEnd(NamedTuple):
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
        modes: every mode with its first tick's time.
        mode_s: seconds by mode; limited_s, blocked_s: with a cause that limits, stops or cuts.
        effect_s: seconds by effect.
        stops: every end of ACTIVE.
    """

    modes: list[tuple[int, str]] = field(default_factory=list)
    mode_s: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
    effect_s: defaultdict[str, float] = field(default_factory=lambda: defaultdict(float))
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
        """A stretch begins with these causes and this mode."""
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

    def _change_mode(self, mode: str, now_ns: int) -> None:
        if mode != self._mode:
            self._mode = mode
            self.modes.append((now_ns, mode))


def _reason(events: tuple[Event, ...]) -> str:
    reasons = [event.fields["reason"] for event in events if event.name == "mode_changed"]
    return str(reasons[-1]) if reasons else ""
