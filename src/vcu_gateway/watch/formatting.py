"""Formatting of values and cells."""

import textwrap
from typing import Literal

from rich.text import Text

ABSENT = "-"
_MS_PER_S = 1000
_S_PER_MINUTE = 60
_MINUTES_PER_HOUR = 60


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


def milliseconds(duration_us: float | None) -> str:
    return ABSENT if duration_us is None else f"{duration_us / _MS_PER_S:.2f}"


def duration(duration_ms: float | None) -> str:
    """340 ms, 3.2 s, 12:44, 3:12:44: as exact as a person needs it."""
    if duration_ms is None:
        return "never"
    if duration_ms < _MS_PER_S:
        return f"{duration_ms:.0f} ms"
    seconds = duration_ms / _MS_PER_S
    if seconds < _S_PER_MINUTE:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(int(seconds), _S_PER_MINUTE)
    hours, minutes = divmod(minutes, _MINUTES_PER_HOUR)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
