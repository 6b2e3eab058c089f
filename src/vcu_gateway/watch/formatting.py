"""Formatting of values and cells; a quality is a colour and a word or mark, never colour alone."""

import textwrap
from typing import Literal

from rich.text import Text

from vcu_gateway.api.results import Message, QualityName, Signal

ABSENT = "-"
NOT_GOOD_MARK = "!"
QUALITY_STYLES: dict[QualityName, str] = {
    "good": "green",
    "out of range": "yellow",
    "saturated": "yellow",
    "stale": "red",
    "never": "dim",
}
_MS_PER_S = 1000
_DECIMALS = 2


def cell(content: str | Text, width: int, style: str = "", align: Literal["<", ">"] = "<") -> Text:
    """Cell of exactly `width` columns: padded, or cut with an ellipsis."""
    if width <= 0:
        return Text()
    text = content.copy() if isinstance(content, Text) else Text(content, style)
    text.truncate(width, overflow="ellipsis")
    missing = width - text.cell_len
    if missing > 0:
        text.pad_left(missing) if align == ">" else text.pad_right(missing)
    return text


def line(*parts: str | Text) -> Text:
    """The parts in a row, never wrapped."""
    text = Text(no_wrap=True, end="")
    for part in parts:
        text.append(part)
    return text


def wrapped(sentence: str, width: int, max_lines: int, indent: int = 0) -> list[str]:
    """The sentence in at most `max_lines`; the first begins after `indent` columns."""
    lines = textwrap.wrap(
        sentence, max(width, 20), initial_indent=" " * indent, max_lines=max_lines, placeholder=" …"
    )
    return [lines[0][indent:], *lines[1:]] if lines else [""]


def number(value: float | None, decimals: int = 0) -> str:
    return ABSENT if value is None else f"{value:.{decimals}f}"


def marked(shown: str, signal: Signal) -> Text:
    """The value, with a mark where it is not good."""
    mark = "" if signal["quality"] == "good" else NOT_GOOD_MARK
    return Text(shown + mark, value_style(signal))


def value_style(signal: Signal) -> str:
    """Style of a value: none where it is good, so that the others stand out."""
    quality = signal["quality"]
    return "" if quality == "good" else QUALITY_STYLES[quality]


def value_text(signal: Signal) -> str:
    """The name of its code, or its value."""
    value = signal["value"]
    return signal.get("name", number(value, _DECIMALS if isinstance(value, float) else 0))


def rate_text(message: Message) -> str:
    """Frames a second, from the measured period; empty where none is."""
    period_ms = message["period_ms"]
    return f"{_MS_PER_S / period_ms:.1f}" if period_ms else ""
