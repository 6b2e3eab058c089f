"""Decoded frames of a log: counted, and written as JSON lines or CSV.

A signal's text follows from its raw code alone, so it is made once a code and kept.
"""

import csv
import io
import json
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping
from decimal import Decimal
from functools import lru_cache

from vcu_gateway.core.codec import Decoded, Reason
from vcu_gateway.core.spec import MessageSpec, SignalSpec
from vcu_gateway.core.state import Quality, mark
from vcu_gateway.units import NS_PER_S

_KEPT_IDENTIFIERS = 4096


class Tally:
    """Counts identifiers; with very many of them, the rare ones are forgotten by name."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()
        self.forgotten = 0

    def add(self, can_id: int) -> None:
        self._counts[can_id] += 1
        if len(self._counts) > _KEPT_IDENTIFIERS:
            kept = Counter(dict(self._counts.most_common(_KEPT_IDENTIFIERS // 2)))
            self.forgotten += self._counts.total() - kept.total()
            self._counts = kept

    def lines(self, digits: int) -> Iterator[str]:
        """The most frequent identifiers, and the frames of all others in one line."""
        shown = self._counts.most_common(10)
        at_least = "at least " if self.forgotten else ""
        for can_id, count in shown:
            yield f"{can_id:0{digits}X} {at_least}{count}"
        rest = self._counts.total() + self.forgotten - sum(count for _, count in shown)
        if rest:
            yield f"others {rest}"


class Summary:
    """Frames of one recording by what became of them; `--message` passed some over."""

    def __init__(self) -> None:
        self.decoded: Counter[str] = Counter()
        self.passed_over = 0
        self._rejected: Counter[str] = Counter()
        by_identifier = (Reason.UNKNOWN, Reason.FOREIGN_SOURCE, Reason.STANDARD)
        self._identifiers = {reason.value: Tally() for reason in by_identifier}

    @property
    def frames(self) -> int:
        return self.decoded.total() + self.passed_over + self._rejected.total()

    def reject(self, reason: Reason, can_id: int) -> None:
        self._rejected[reason.value] += 1
        if tally := self._identifiers.get(reason.value):
            tally.add(can_id)

    def reject_fd(self) -> None:
        self._rejected["fd"] += 1  # beside the reasons of the codec, which knows a classic bus

    def lines(self, unreadable: int) -> Iterator[str]:
        """The summary, for people; what is unreadable is no frame."""
        rejected = self._rejected.total()
        yield (
            f"frames {self.frames}: decoded {self.decoded.total()}, not decoded {rejected}"
            + (f", not asked for {self.passed_over}" if self.passed_over else "")
            + (f"; unreadable {unreadable}" if unreadable else "")
        )
        yield from (f"  {name} {count}" for name, count in sorted(self.decoded.items()))
        if rejected:
            yield "not decoded:"
        for reason, count in self._rejected.most_common():
            yield f"  {reason} {count}"
            if tally := self._identifiers.get(reason):
                digits = 3 if reason == Reason.STANDARD.value else 8
                yield from (f"    {line}" for line in tally.lines(digits))


class FrameWriter(ABC):
    """Writes out the frames of one message; a format is a class, and `head` its first line."""

    head = ""

    def __init__(self, message: MessageSpec) -> None:
        self._message = message
        self._decimals = [decimals(signal) for signal in message.signals]
        self._kept: list[dict[int, str]] = [{} for _ in message.signals]

    def text(self, arrival_ns: int, channel: str | None, decoded: Decoded) -> str:
        try:
            signals = [kept[raw] for kept, raw in zip(self._kept, decoded.raws, strict=True)]
        except KeyError:
            signals = [self._signal(index, decoded) for index in range(len(decoded.raws))]
        return self._frame_text(f"{arrival_ns / NS_PER_S:.6f}", channel, signals)

    def _signal(self, index: int, decoded: Decoded) -> str:
        raw, kept = decoded.raws[index], self._kept[index]
        if raw not in kept:
            signal = self._message.signals[index]
            # Adding 0 turns a rounded -0.0 into 0.0.
            value = round(decoded.values[index], self._decimals[index]) + 0
            if len(kept) >= 8192:  # 16-bit noise must not fill the memory
                kept.clear()
            kept[raw] = self._signal_text(signal, value, raw, mark(decoded, index, signal))
        return kept[raw]

    @abstractmethod
    def _signal_text(self, signal: SignalSpec, value: float, raw: int, quality: Quality) -> str: ...

    @abstractmethod
    def _frame_text(self, time_s: str, channel: str | None, signals: list[str]) -> str: ...


def decimals(signal: SignalSpec) -> int:
    """How many decimals raw * factor + offset can have; more is noise of the floats."""
    numbers = (Decimal(repr(number)).normalize() for number in (signal.factor, signal.offset))
    return max(0, *(-int(number.as_tuple().exponent) for number in numbers))


_json_text = lru_cache(maxsize=1024)(json.dumps)


class _JsonWriter(FrameWriter):
    """A JSON object on a line for each frame."""

    def _signal_text(self, signal: SignalSpec, value: float, raw: int, quality: Quality) -> str:
        name = f', "name": {_json_text(signal.names.get(raw))}' if signal.names else ""
        return (
            f'"{signal.name}": {{"value": {value!r}, "unit": {_json_text(signal.unit)}, '
            f'"raw": {raw}, "quality": "{quality.value}"{name}}}'
        )

    def _frame_text(self, time_s: str, channel: str | None, signals: list[str]) -> str:
        head = f'"time": {time_s}, "channel": {_json_text(channel)}'
        message = f'"message": "{self._message.name}", "signals": {{{", ".join(signals)}}}'
        return f"{{{head}, {message}}}\n"


@lru_cache(maxsize=1024)
def _csv_field(text: str | None) -> str:
    if not text:
        return ""
    row = io.StringIO()
    csv.writer(row, lineterminator="").writerow([text])
    return row.getvalue()


class _CsvWriter(FrameWriter):
    """A line for each signal of a frame."""

    head = "time,channel,message,signal,value,unit,raw,quality,name\n"

    def _signal_text(self, signal: SignalSpec, value: float, raw: int, quality: Quality) -> str:
        name, unit = _csv_field(signal.names.get(raw)), _csv_field(signal.unit)
        head = f"{self._message.name},{signal.name},{value!r}"
        return f"{head},{unit},{raw},{quality.value},{name}\n"

    def _frame_text(self, time_s: str, channel: str | None, signals: list[str]) -> str:
        start = f"{time_s},{_csv_field(channel)},"
        return "".join([start + signal for signal in signals])


FORMATS: Mapping[str, type[FrameWriter]] = {"jsonl": _JsonWriter, "csv": _CsvWriter}
