"""List of received signals: value, unit and quality, under message, age and rate."""

from rich.text import Text

from vcu_gateway.api.results import Message, Signal, State
from vcu_gateway.text import narrow_duration
from vcu_gateway.watch.formatting import (
    QUALITY_STYLES,
    cell,
    line,
    rate_text,
    value_style,
    value_text,
)

COLUMNS = 59
"""Least width of one column of signals."""

_GAP = 2
_NAME_COLUMNS = 25
_VALUE_COLUMNS = 16
_UNIT_COLUMNS = 6
_KNOWN_COLUMNS = _NAME_COLUMNS + _VALUE_COLUMNS + _UNIT_COLUMNS


def signal_lines(
    state: State | None, width: int, filter_text: str = "", old: bool = False
) -> list[Text]:
    """Signals by message, in as many columns as fit.

    Args:
        state: None before the first answer.
        width: of the terminal, in columns.
        filter_text: part of the message or signal names to show.
        old: the gateway is not reachable: ages and qualities are unknown.
    """
    blocks = [] if state is None else _blocks(state, filter_text.casefold(), old)
    if not blocks:
        nothing = f"no message or signal has “{filter_text}” in its name" if filter_text else ""
        return [Text(nothing, "dim")]
    count = max(1, (width + _GAP) // (COLUMNS + _GAP))
    columns = _columns(blocks, count)
    height = max(len(column) for column in columns)
    column_width = (width - _GAP * (count - 1)) // count
    return [_across(columns, row, column_width) for row in range(height)]


def _across(columns: list[list[Text]], row: int, width: int) -> Text:
    cells: list[str | Text] = []
    for column in columns:
        cells += [" " * _GAP] if cells else []
        cells.append(cell(column[row] if row < len(column) else "", width))
    return line(*cells)


def _columns(blocks: list[list[Text]], count: int) -> list[list[Text]]:
    """The blocks in order, none torn apart, in columns as short as they can be."""
    height = max(len(block) for block in blocks)
    while True:
        columns = _filled(blocks, height)
        if len(columns) <= count:
            return columns
        height += 1


def _filled(blocks: list[list[Text]], height: int) -> list[list[Text]]:
    columns: list[list[Text]] = [[]]
    for block in blocks:
        if columns[-1] and len(columns[-1]) + len(block) > height:
            columns.append([])
        columns[-1] += block
    return columns


def _blocks(state: State, wanted: str, old: bool) -> list[list[Text]]:
    blocks = []
    for name, message in state["messages"].items():
        whole = wanted in name.casefold()
        shown = [
            (_old_signal if old else _signal)(signal_name, signal)
            for signal_name, signal in message["signals"].items()
            if whole or wanted in signal_name.casefold()
        ]
        if shown:
            head = Text(name, "dim bold") if old else _message(name, message)
            blocks.append([head, *shown])
    return blocks


def _message(name: str, message: Message) -> Text:
    age_ms = message["age_ms"]
    age = "never" if age_ms is None else f"{narrow_duration(age_ms)} old"
    style, rate = "red" if message["stale"] else "", rate_text(message)
    return line(
        cell(name, _NAME_COLUMNS, f"bold {style}"),
        cell(age, _VALUE_COLUMNS, style, ">"),
        cell(rate and f"{rate} Hz", _UNIT_COLUMNS + 5, align=">"),
        Text(" stale" if message["stale"] else "", style),
    )


def _signal(name: str, signal: Signal) -> Text:
    return line(
        cell(f"  {name}", _NAME_COLUMNS),
        cell(value_text(signal), _VALUE_COLUMNS, value_style(signal), ">"),
        cell(f" {signal['unit']}", _UNIT_COLUMNS, "dim"),
        Text(signal["quality"], QUALITY_STYLES[signal["quality"]]),
    )


def _old_signal(name: str, signal: Signal) -> Text:
    return Text(f"{_signal(name, signal).plain[:_KNOWN_COLUMNS]}old", "dim")
