"""Decisions of the gateway in a recording: modes, events, causes and `why`, by wall time."""

from array import array
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from vcu_gateway.core.supervisor import Mode
from vcu_gateway.time_window import Window

MODES = tuple(mode.value for mode in Mode)
"""Names of the modes; the index of each is its code in a table."""

NEVER_RECEIVED = "never received"
"""Detail of a cause whose message has not come since the start."""


class DecidedEvent(NamedTuple):
    """Event of the gateway; the stamp is its tick's."""

    wall_ns: int
    name: str
    severity: int
    fields: Mapping[str, object]

    @property
    def text(self) -> str:
        """The fields in one line."""
        return ", ".join(f"{key} {value}" for key, value in self.fields.items() if value != "")


class CauseSpan(NamedTuple):
    """Time in which one cause counted; `ended_ns` is None where it did at the end."""

    subject: str
    effect: str
    detail: str
    began_ns: int
    ended_ns: int | None


class Decisions:
    """What the gateway decided inside the window.

    Attributes:
        tick_times_ns, tick_modes: of every tick; the mode as a code of MODES.
        events: every event, in order.
        whys: stamp and sentence, on change.
        gaps: stamp and sentence of each hole in the recording.
    """

    def __init__(self, window: Window) -> None:
        self.tick_times_ns = array("q")
        self.tick_modes = array("b")
        self.events: list[DecidedEvent] = []
        self.whys: list[tuple[int, str]] = []
        self.gaps: list[tuple[int, str]] = []
        self._window = window
        self._standing: dict[tuple[str, str], CauseSpan] = {}
        self._ended: list[CauseSpan] = []
        self._mode = 0

    def begin(self, wall_ns: int, mode: str, why: str) -> None:
        """State at the begin of a segment."""
        self._mode = MODES.index(mode)
        self.why(wall_ns, why)

    def tick(self, wall_ns: int, mode: str | None) -> None:
        """One tick; its mode, None where it is that of the tick before."""
        if mode is not None:
            self._mode = MODES.index(mode)
        if self._window.holds(wall_ns):
            self.tick_times_ns.append(wall_ns)
            self.tick_modes.append(self._mode)

    def why(self, wall_ns: int, sentence: str) -> None:
        """Explanation from here on."""
        if self._window.holds(wall_ns) and (not self.whys or self.whys[-1][1] != sentence):
            self.whys.append((wall_ns, sentence))

    def stand(self, wall_ns: int, causes: Iterable[tuple[str, str, str]]) -> None:
        """Causes that count at a checkpoint: (subject, effect, detail) of each."""
        found = {(subject, effect): detail for subject, effect, detail in causes}
        for key in [key for key in self._standing if key not in found]:
            self._end(key, wall_ns)
        for (subject, effect), detail in found.items():
            self._begin(subject, effect, detail, wall_ns)

    def event(self, event: DecidedEvent) -> None:
        """One event; those of causes make their spans."""
        fields = {name: str(event.fields.get(name, "")) for name in ("subject", "effect", "detail")}
        if event.name == "cause_began":
            self._begin(fields["subject"], fields["effect"], fields["detail"], event.wall_ns)
        elif event.name == "cause_ended":
            self._end((fields["subject"], fields["effect"]), event.wall_ns)
        if self._window.holds(event.wall_ns):
            self.events.append(event)

    def gap(self, wall_ns: int, what: str) -> None:
        """A hole of the recording."""
        if self._window.holds(wall_ns):
            self.gaps.append((wall_ns, what))

    def _begin(self, subject: str, effect: str, detail: str, wall_ns: int) -> None:
        span = CauseSpan(subject, effect, detail, wall_ns, None)
        self._standing.setdefault((subject, effect), span)

    def _end(self, key: tuple[str, str], wall_ns: int) -> None:
        span = self._standing.pop(key, None)
        if span is not None:
            self._ended.append(span._replace(ended_ns=wall_ns))

    @property
    def causes(self) -> list[CauseSpan]:
        """Every span that touches the window, in the order of their beginnings."""
        spans = [*self._ended, *self._standing.values()]
        if not self._window.open and self.tick_times_ns:
            first_ns, last_ns = self.tick_times_ns[0], self.tick_times_ns[-1]
            spans = [
                one
                for one in spans
                if one.began_ns <= last_ns and (one.ended_ns is None or one.ended_ns >= first_ns)
            ]
        return sorted(spans, key=lambda span: span.began_ns)
