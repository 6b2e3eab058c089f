"""Core lines of a drive, as decisions of the gateway."""

import contextlib
import io
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from vcu_gateway.core.causes import Event
from vcu_gateway.core.codec import Codec
from vcu_gateway.errors import DataError, Problem
from vcu_gateway.export.decisions import DecidedEvent, Decisions
from vcu_gateway.recording.checkpoint import StateError, restore
from vcu_gateway.recording.core_lines import (
    Checkpoint,
    CoreRecord,
    Gap,
    LineError,
    LineParser,
    ShellEvent,
    TickRecord,
    WhyRecord,
)
from vcu_gateway.recording.reader import clock_of

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
        self._latest_ns = 0
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
                self._tick(int(plain[1]), None)
            elif not _OF_THE_RECORDER.match(line):
                self._read(number, line, damaged)

    def gap(self, what: str) -> None:
        """Something is missing here; what stands is known again from the next checkpoint on."""
        self._unknown = True
        self._decisions.gap(self._latest_ns, what)

    def _read(self, number: int, line: bytes, damaged: Damaged) -> None:
        try:
            records = [placed.record for placed in self._parser.records(line)]
        except LineError as error:
            self.unreadable += 1
            damaged(number, str(error))
            return
        for record in records:
            self._take(record)

    def _take(self, record: CoreRecord) -> None:
        if isinstance(record, TickRecord):
            self._tick(record.now_ns, record.mode.value)
            for event in record.events:
                self._event(event)
        elif isinstance(record, WhyRecord):
            self._decisions.why(self._wall_ns(record.now_ns), record.sentence)
        elif isinstance(record, ShellEvent):
            self._latest_ns = self._wall_ns(record.now_ns)
            self._event(record.event)
        elif isinstance(record, Checkpoint):
            self._checkpoint(record)
        elif isinstance(record, Gap):
            self.gap(_missing(record))

    def _checkpoint(self, record: Checkpoint) -> None:
        self._latest_ns = self._wall_ns(record.now_ns)
        self._decisions.begin(self._latest_ns, record.mode.value, record.why)
        if not self._unknown:
            return
        self._unknown = False
        # Damaged, or of another version: causes are then known from their next change on.
        with contextlib.suppress(StateError):
            gateway = restore(record.state, self._codec, record.settings)
            self._decisions.stand(self._latest_ns, gateway.causes.held)

    def _tick(self, now_ns: int, mode: str | None) -> None:
        self._latest_ns = self._wall_ns(now_ns)
        self._decisions.tick(self._latest_ns, mode)

    def _event(self, event: Event) -> None:
        one = DecidedEvent(self._latest_ns, event.name, event.severity, event.fields)
        self._decisions.event(one)

    def _wall_ns(self, monotonic_ns: int) -> int:
        return monotonic_ns + self._to_wall_ns


def _missing(gap: Gap) -> str:
    counts = (("frames", gap.frames), ("ticks", gap.ticks), ("datagrams", gap.datagrams))
    lost = ", ".join(f"{count} {what}" for what, count in counts if count)
    return "; ".join(filter(None, (f"{lost} missing" if lost else "", gap.why)))
