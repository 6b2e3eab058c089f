"""Received signals as a list in columns; the whole view model as plain text, for a pipe."""

from collections.abc import Iterator

from rich.text import Text

from vcu_gateway.api.results import Message, Signal, State
from vcu_gateway.text import narrow_duration
from vcu_gateway.watch import figures, layout
from vcu_gateway.watch.figures import (
    ABSENT,
    QUALITY_STYLES,
    cell,
    line,
    marked,
    number,
    rate_text,
    value_style,
    value_text,
    wrapped,
)
from vcu_gateway.watch.source import ViewModel

LIST_COLUMNS = 59
"""Least width of one column of signals."""

_GAP = 2
_NAME_COLUMNS = 25
_VALUE_COLUMNS = 16
_UNIT_COLUMNS = 6
_KNOWN_COLUMNS = _NAME_COLUMNS + _VALUE_COLUMNS + _UNIT_COLUMNS
_COLUMNS = 120
_MOST_LINES = 12
_NO_BREAK_SPACE = "\u00a0"


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
    count = max(1, (width + _GAP) // (LIST_COLUMNS + _GAP))
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


def plain(title: str, view: ViewModel) -> str:
    """The whole view model; ends with a line feed."""
    lines = [
        layout.title_line(title, view, _COLUMNS),
        *_sentence(view),
        *layout.reason_lines(view.why, _COLUMNS, _MOST_LINES),
        *figures.controller_lines(view.state, roomy=True),
        *figures.short_lines(view.health),
    ]
    shown = [line.plain.rstrip() for line in lines]
    if view.state is not None:
        shown += _messages(view.state)
    return "\n".join(shown) + "\n"


def _sentence(view: ViewModel) -> list[Text]:
    """The gateway's summary and its own sentence, whole; or why there is none."""
    if view.why is None or view.problem is not None:
        return layout.mode_lines(view, _COLUMNS, _MOST_LINES)
    sentences = view.why.get("summary"), view.why["sentence"]
    return [Text(part) for one in sentences if one for part in wrapped(one, _COLUMNS, _MOST_LINES)]


def _messages(state: State) -> Iterator[str]:
    yield f"{'received':<20}{'age ms':>7}{'Hz':>7}  signals"
    for name, message in state["messages"].items():
        age = number(message["age_ms"]) if message["age_ms"] is not None else "never"
        begin = f"{name:<20}{age:>7}{rate_text(message) or ABSENT:>7}  "
        first, *rest = wrapped(_signals(message), _COLUMNS - len(begin), _MOST_LINES)
        yield _spaced(begin + first)
        yield from (_spaced(" " * len(begin) + more) for more in rest)


def _signals(message: Message) -> str:
    """Quantities, and codes that are not 0: what a person looks for."""
    return ", ".join(
        f"{name} {_value(signal)}".replace(" ", _NO_BREAK_SPACE)
        for name, signal in message["signals"].items()
        if signal["value"] is not None and (signal["unit"] or signal["raw"])
    )


def _value(signal: Signal) -> str:
    return marked(f"{value_text(signal)} {signal['unit']}".rstrip(), signal).plain


def _spaced(line: str) -> str:
    return line.replace(_NO_BREAK_SPACE, " ").rstrip()
