"""Decoded frames as text: JSON lines or CSV.

A signal's text follows from its raw code alone, so it is made once a code and kept.
"""

import csv
import io
import json
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from functools import lru_cache

from vcu_gateway.core.codec import Decoded
from vcu_gateway.core.spec import MessageSpec, SignalSpec
from vcu_gateway.core.state import Quality, mark
from vcu_gateway.units import NS_PER_S

# Codes of one signal whose texts are kept; 16-bit noise must not fill the memory.
_KEPT_CODES = 8192
_CSV_COLUMNS = "time,channel,message,signal,value,unit,raw,quality,name\n"


@dataclass(frozen=True, slots=True)
class FrameFormat:
    """How the parts of a decoded frame are written.

    Attributes:
        head: the first line, or nothing.
        signal: (message, signal, value, raw, quality) -> text.
        frame: (time in seconds, channel, message, texts of the signals) -> lines.
    """

    head: str
    signal: Callable[[MessageSpec, SignalSpec, float, int, Quality], str]
    frame: Callable[[str, str | None, MessageSpec, list[str]], str]


class FrameWriter:
    """Writes out the frames of one message."""

    def __init__(self, message: MessageSpec, text_format: FrameFormat) -> None:
        self._message = message
        self._format = text_format
        self._decimals = [decimals(signal) for signal in message.signals]
        self._kept: list[dict[int, str]] = [{} for _ in message.signals]

    def text(self, arrival_ns: int, channel: str | None, decoded: Decoded) -> str:
        try:
            signals = [kept[raw] for kept, raw in zip(self._kept, decoded.raws, strict=True)]
        except KeyError:
            signals = [self._signal(index, decoded) for index in range(len(decoded.raws))]
        time_s = f"{arrival_ns / NS_PER_S:.6f}"
        return self._format.frame(time_s, channel, self._message, signals)

    def _signal(self, index: int, decoded: Decoded) -> str:
        raw, kept = decoded.raws[index], self._kept[index]
        if raw not in kept:
            signal = self._message.signals[index]
            # Adding 0 turns a rounded -0.0 into 0.0.
            value = round(decoded.values[index], self._decimals[index]) + 0
            if len(kept) >= _KEPT_CODES:
                kept.clear()
            quality = mark(decoded, index, signal)
            kept[raw] = self._format.signal(self._message, signal, value, raw, quality)
        return kept[raw]


def decimals(signal: SignalSpec) -> int:
    """How many decimals raw * factor + offset can have; more is noise of the floats."""
    numbers = (Decimal(repr(number)).normalize() for number in (signal.factor, signal.offset))
    return max(0, *(-int(number.as_tuple().exponent) for number in numbers))


@lru_cache(maxsize=1024)
def _json_text(text: str | None) -> str:
    return json.dumps(text)


def _json_signal(
    message: MessageSpec, signal: SignalSpec, value: float, raw: int, quality: Quality
) -> str:
    del message
    name = f', "name": {_json_text(signal.names.get(raw))}' if signal.names else ""
    return (
        f'"{signal.name}": {{"value": {value!r}, "unit": {_json_text(signal.unit)}, '
        f'"raw": {raw}, "quality": "{quality.value}"{name}}}'
    )


def _json_frame(time_s: str, channel: str | None, message: MessageSpec, signals: list[str]) -> str:
    return (
        f'{{"time": {time_s}, "channel": {_json_text(channel)}, "message": "{message.name}", '
        f'"signals": {{{", ".join(signals)}}}}}\n'
    )


@lru_cache(maxsize=1024)
def _csv_field(text: str | None) -> str:
    if not text:
        return ""
    row = io.StringIO()
    csv.writer(row, lineterminator="").writerow([text])
    return row.getvalue()


def _csv_signal(
    message: MessageSpec, signal: SignalSpec, value: float, raw: int, quality: Quality
) -> str:
    name = _csv_field(signal.names.get(raw))
    unit = _csv_field(signal.unit)
    return f"{message.name},{signal.name},{value!r},{unit},{raw},{quality.value},{name}\n"


def _csv_frame(time_s: str, channel: str | None, message: MessageSpec, signals: list[str]) -> str:
    del message
    start = f"{time_s},{_csv_field(channel)},"
    return "".join([start + signal for signal in signals])


FORMATS = {
    "jsonl": FrameFormat("", _json_signal, _json_frame),
    "csv": FrameFormat(_CSV_COLUMNS, _csv_signal, _csv_frame),
}
