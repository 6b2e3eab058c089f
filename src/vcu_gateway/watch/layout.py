"""Layout of the lines above the signals, by the terminal's size."""

from rich.text import Text

from vcu_gateway.watch import bus, controllers, header
from vcu_gateway.watch.formatting import cell, line
from vcu_gateway.watch.reasons import next_lines, reason_lines
from vcu_gateway.watch.view_model import ViewModel

TALL_LINES = 32
"""From here on there is room for more than the needed."""

_GAP = 2
_WIDE_COLUMNS = controllers.COLUMNS + _GAP + bus.PANEL_COLUMNS
_SENTENCE_LINES, _SENTENCE_LINES_TALL = 3, 6
_REASON_LINES, _REASON_LINES_TALL = 4, 10
_PANEL_LINES = 13


def upper_lines(
    title: str, view: ViewModel, width: int, height: int, paused: bool = False
) -> list[Text]:
    """Header, reasons, controllers and bus: 20 lines at most in 80 x 24."""
    tall = height >= TALL_LINES
    gap = [Text()] if tall else []
    return [
        header.title_line(title, view, width, paused),
        *_explanation(view, width, tall),
        *gap,
        *_figures(view, width, tall),
        *gap,
    ]


def _explanation(view: ViewModel, width: int, tall: bool) -> list[Text]:
    """Mode, summary and reasons; where room is short, what to do in place of the long sentence."""
    why = view.why
    if why is None or view.problem is not None:
        return header.mode_lines(view, width, _SENTENCE_LINES)
    stop = header.stop_lines(view, width)
    most = (_REASON_LINES_TALL if tall else _REASON_LINES) - len(stop[1:])
    reasons = reason_lines(why, width, most)
    if not reasons:
        return header.mode_lines(view, width, _SENTENCE_LINES) + stop
    if not tall:
        sentence = f"next: {why['next_step']}"
        mode = header.mode_lines(view, width, _SENTENCE_LINES, sentence)
        most -= max(0, len(mode) + len(stop) - _SENTENCE_LINES)
        return mode + stop + reason_lines(why, width, most)
    mode = header.mode_lines(view, width, _SENTENCE_LINES_TALL)
    return [*mode, *stop, Text(), *reasons, *next_lines(why, width)]


def _figures(view: ViewModel, width: int, tall: bool) -> list[Text]:
    """Controllers above the bus, or beside it where the terminal is wide."""
    wide = width >= _WIDE_COLUMNS
    old = view.problem is not None
    left = controllers.controller_lines(view.state, tall, old)
    if not wide:
        lines = left + bus.short_lines(view.health)
        return _faded(lines) if old else lines
    room = width - controllers.COLUMNS - _GAP
    right = bus.panel_lines(view.health, room)[: max(len(left), _PANEL_LINES)]
    lines = [
        line(_at(left, row, controllers.COLUMNS), " " * _GAP, _at(right, row, room))
        for row in range(max(len(left), len(right)))
    ]
    return _faded(lines) if old else lines


def _at(lines: list[Text], row: int, width: int) -> Text:
    return cell(lines[row] if row < len(lines) else "", width)


def _faded(lines: list[Text]) -> list[Text]:
    return [Text(one.plain, "dim") for one in lines]
