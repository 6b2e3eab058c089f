"""Decisions of the gateway in a recording: modes, events, causes and `why`, by wall time.

Core lines of a drive, as decisions of the gateway.
"""

import contextlib
import io
import re
from array import array
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from vcu_gateway.core.causes import Event
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.errors import DataError, Problem
from vcu_gateway.recording.checkpoint import StateError, restore
from vcu_gateway.recording.core_lines import (
    Checkpoint,
    CoreRecord,
    Gap,
    LineParser,
    ShellEvent,
    TickRecord,
    WhyRecord,
)
from vcu_gateway.recording.datagram import CoreLineError
from vcu_gateway.recording.reader import CauseSpan, CauseSpans, clock_of
from vcu_gateway.time_window import Window

MODES = tuple(mode.value for mode in Mode)
"""Names of the modes; the index of each is its code in a table."""

NEVER_RECEIVED = "never received"
"""Detail of a cause whose message has not come since the start."""


class DecidedEvent(NamedTuple):
    """Event of the gateway; the stamp is its tick's, the severity a level of the log."""

    wall_ns: int
    name: str
    severity: str
    fields: Mapping[str, object]

    @property
    def text(self) -> str:
        return ", ".join(f"{key} {value}" for key, value in self.fields.items() if value != "")


class Decisions:
    """What the gateway decided inside the window, as `CoreLines` reads it; else nothing.

    Attributes:
        tick_times_ns, tick_modes: of every tick; the mode as a code of MODES.
        events: every event, in order.
        whys: stamp and sentence, on change.
        gaps: stamp and sentence of each hole in the recording.
        drive_modes: stamp and name of each from where it counts, those before the window too; none
            where there are none.
    """

    def __init__(self, window: Window) -> None:
        self.tick_times_ns = array("q")
        self.tick_modes = array("b")
        self.events: list[DecidedEvent] = []
        self.whys: list[tuple[int, str]] = []
        self.gaps: list[tuple[int, str]] = []
        self.drive_modes: list[tuple[int, str]] = []
        self.cause_spans = CauseSpans()
        self.window = window

    @property
    def causes(self) -> list[CauseSpan]:
        """Every span that touches the window, in the order of their beginnings."""
        spans = self.cause_spans.spans
        if not self.window.open and self.tick_times_ns:
            first_ns, last_ns = self.tick_times_ns[0], self.tick_times_ns[-1]
            spans = [
                one
                for one in spans
                if one.began_ns <= last_ns and (one.ended_ns is None or one.ended_ns >= first_ns)
            ]
        return spans


# A tick without a change: nine of ten lines.
_PLAIN_TICK = re.compile(
    rb'\{"f":\d+,"tick":(\d{1,18}),"frames":\[[^{}]*\](?:,"ok":\[[a-z,]*\])?\}'
)
# Lines of the recorder itself.
_OF_THE_RECORDER = re.compile(rb'\{"f":\d+,"(?:begin|end)":')

Damaged = Callable[[int, str], None]


class CoreLines:
    """Reads the core lines of one drive's segments in their order.

    Attributes:
        unreadable: lines that are no core lines.
    """

    def __init__(
        self, decisions: Decisions, description: Mapping[str, Any], codec: Codec, where: Path
    ) -> None:
        self.unreadable = 0
        self._codec = codec
        self._unknown = True
        self._decisions = decisions
        self._parser = LineParser()
        self._latest_ns = self._mode = 0
        try:
            self._to_wall_ns = clock_of(description).distance_ns
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(Problem("has no pair of clocks", str(where))) from error

    def add(self, text: bytes, damaged: Damaged) -> None:
        """Take in whole lines; of each that is none `damaged` is given its number and why."""
        for number, ended in enumerate(io.BytesIO(text), 1):
            line = ended.removesuffix(b"\n")
            plain = _PLAIN_TICK.fullmatch(line)
            if plain is not None:
                self._tick(int(plain[1]))
            elif not _OF_THE_RECORDER.match(line):
                self._read(number, line, damaged)

    def gap(self, what: str) -> None:
        """Something is missing here; what stands is known again from the next checkpoint on."""
        self._unknown = True
        self._note(self._decisions.gaps, what)

    def _note(self, row: list[tuple[int, str]], text: str) -> None:
        if self._decisions.window.holds(self._latest_ns):
            row.append((self._latest_ns, text))

    def _read(self, number: int, line: bytes, damaged: Damaged) -> None:
        try:
            for placed in self._parser.records(line):
                self._take(placed.record)
        except CoreLineError as error:
            self.unreadable += 1
            damaged(number, str(error))

    def _take(self, record: CoreRecord) -> None:
        if isinstance(record, TickRecord):
            self._mode = MODES.index(record.mode.value)
            self._tick(record.now_ns)
            for event in record.events:
                self._event(event)
        elif isinstance(record, WhyRecord):
            self._latest_ns = record.now_ns + self._to_wall_ns
            self._why(record.sentence)
        elif isinstance(record, ShellEvent):
            self._latest_ns = record.now_ns + self._to_wall_ns
            self._event(record.event)
        elif isinstance(record, Checkpoint):
            self._checkpoint(record)
        elif isinstance(record, Gap):
            self.gap(_missing(record))

    def _checkpoint(self, record: Checkpoint) -> None:
        self._latest_ns = record.now_ns + self._to_wall_ns
        self._mode = MODES.index(record.mode.value)
        self._why(record.why)
        if not self._unknown:
            return
        self._unknown = False
        # Damaged, or of another version: causes are then known from their next change on.
        with contextlib.suppress(StateError):
            gateway = restore(record.state, self._codec, record.settings)
            self._decisions.cause_spans.stand(gateway.causes.held, self._latest_ns)
            drive_mode, _ = gateway.drive_modes
            if drive_mode is not None:
                self._drive_mode(drive_mode)

    def _tick(self, now_ns: int) -> None:
        """One tick; its mode is that of the tick before, or what was told with it."""
        stamp_ns = self._latest_ns = now_ns + self._to_wall_ns
        if self._decisions.window.holds(stamp_ns):
            self._decisions.tick_times_ns.append(stamp_ns)
            self._decisions.tick_modes.append(self._mode)

    def _why(self, sentence: str) -> None:
        whys = self._decisions.whys
        if not whys or whys[-1][1] != sentence:
            self._note(whys, sentence)

    def _event(self, event: Event) -> None:
        found, severity = self._decisions, event.severity.name.lower()
        found.cause_spans.event(event.name, event.fields, self._latest_ns)
        if found.window.holds(self._latest_ns):
            found.events.append(DecidedEvent(self._latest_ns, event.name, severity, event.fields))
        if event.name == "drive_mode_changed":
            self._drive_mode(str(event.fields["mode"]))

    def _drive_mode(self, name: str) -> None:
        known = self._decisions.drive_modes
        if not known or known[-1][1] != name:
            known.append((self._latest_ns, name))


def _missing(gap: Gap) -> str:
    counts = (("frames", gap.frames), ("ticks", gap.ticks), ("datagrams", gap.datagrams))
    lost = ", ".join(f"{count} {what}" for what, count in counts if count)
    return "; ".join(filter(None, (f"{lost} missing" if lost else "", gap.why)))
