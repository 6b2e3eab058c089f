"""Decisions of the gateway in a recording: modes, events, causes and `why`, by wall time."""

from array import array
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from vcu_gateway.core.causes import HeldCause
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.recording.cause_spans import CauseSpan, CauseSpans
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
        return ", ".join(f"{key} {value}" for key, value in self.fields.items() if value != "")


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
        self._causes = CauseSpans()
        self._mode = 0

    def begin(self, wall_ns: int, mode: str, why: str) -> None:
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
        if self._window.holds(wall_ns) and (not self.whys or self.whys[-1][1] != sentence):
            self.whys.append((wall_ns, sentence))

    def stand(self, wall_ns: int, held: Iterable[HeldCause]) -> None:
        self._causes.stand(held, wall_ns)

    def event(self, event: DecidedEvent) -> None:
        """One event; those of causes make their spans."""
        self._causes.event(event.name, event.fields, event.wall_ns)
        if self._window.holds(event.wall_ns):
            self.events.append(event)

    def gap(self, wall_ns: int, what: str) -> None:
        if self._window.holds(wall_ns):
            self.gaps.append((wall_ns, what))

    @property
    def causes(self) -> list[CauseSpan]:
        """Every span that touches the window, in the order of their beginnings."""
        spans = self._causes.spans
        if not self._window.open and self.tick_times_ns:
            first_ns, last_ns = self.tick_times_ns[0], self.tick_times_ns[-1]
            spans = [
                one
                for one in spans
                if one.began_ns <= last_ns and (one.ended_ns is None or one.ended_ns >= first_ns)
            ]
        return spans
