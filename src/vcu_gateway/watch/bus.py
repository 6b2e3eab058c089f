"""Figures of bus, ticks and API: three lines, or a panel where there is room."""

from collections.abc import Mapping
from typing import Any

from rich.text import Text

from vcu_gateway.api.results import Health
from vcu_gateway.text import narrow_duration
from vcu_gateway.watch.formatting import ABSENT, cell, line

PANEL_COLUMNS = 44
"""Least width of the panel."""

_LABEL_COLUMNS = 10
_FIGURE_COLUMNS = 17
_LINK_STYLES = {"up": "green", "error warning": "yellow"}
_BAD_STYLE = "bold yellow"


def short_lines(health: Health | None) -> list[Text]:
    """Three lines: the link with what passed, what was lost, and the ticks."""
    if health is None:
        return [cell("bus", _LABEL_COLUMNS, "dim"), Text(), cell("ticks", _LABEL_COLUMNS, "dim")]
    frames, ticks = health["frames"], health["ticks"]
    first = [
        _link(health),
        _count("received", frames["received"]),
        _count("sent", frames["sent"]),
        _bad("rejected", sum(frames["rejected"].values())),
    ]
    second = [
        _bad("unsent", sum(frames["unsent"].values())),
        _bad("dropped", frames["dropped"]),
        _bad("foreign", sum(frames["foreign_commands"].values())),
        _bad("blocked", sum(frames["blocked_by_gate"].values())),
    ]
    third = [
        _count("done", ticks["done"]),
        _bad("skipped", ticks["skipped"]),
        line("late ms ", _lateness(health)),
    ]
    return [_row("bus", first), _row("", second), _row("ticks", third)]


def panel_lines(health: Health | None, width: int) -> list[Text]:
    """A line for each fact, with the reasons behind the counts."""
    if health is None:
        return [cell("bus", _LABEL_COLUMNS, "dim")]
    frames, ticks, api = health["frames"], health["ticks"], health["api"]
    link = health["link"]
    bus = Text(f"{link['state']} for {narrow_duration(link['since_ms'])}", _link_style(health))
    rows = [
        ("bus", bus if link["lost"] is None else Text(link["lost"], "red")),
        ("received", Text(f"{frames['received']}, out of order {frames['out_of_order']}")),
        ("rejected", _counted(frames["rejected"])),
        ("dropped", _bad("by the kernel", frames["dropped"])),
        ("sent", Text(str(frames["sent"]))),
        ("confirmed", Text(_listed(frames["confirmed"]))),
        ("unsent", _counted(frames["unsent"])),
        ("foreign", _counted(frames["foreign_commands"])),
        ("blocked", _counted(frames["blocked_by_gate"])),
        (
            "ticks",
            line(f"{ticks['done']}, silent {ticks['silent']}, ", _bad("skipped", ticks["skipped"])),
        ),
        ("late ms", _lateness(health)),
        ("API", Text(f"{api['clients']} clients, {api['requests']} requests")),
        (
            "version",
            Text(f"{health['versions']['vcu_gateway']}, config {health['config_digest'][:8]}"),
        ),
    ]
    return [
        line(cell(label, _LABEL_COLUMNS, "dim"), cell(text, width - _LABEL_COLUMNS))
        for label, text in rows
    ]


def _row(label: str, figures: list[Text]) -> Text:
    cells = [cell(figure, max(_FIGURE_COLUMNS, figure.cell_len)) for figure in figures]
    return line(cell(label, _LABEL_COLUMNS, "dim"), *cells)


def _link(health: Health) -> Text:
    link = health["link"]
    return Text(f"{link['state']} {narrow_duration(link['since_ms'])}", _link_style(health))


def _link_style(health: Health) -> str:
    return _LINK_STYLES.get(health["link"]["state"], "bold red")


def _count(word: str, count: int | None) -> Text:
    return Text(f"{word} {ABSENT if count is None else count}")


def _bad(word: str, count: int | None) -> Text:
    """A count that is 0 in good order."""
    figure = _count(word, count)
    figure.stylize(_BAD_STYLE if count else "")
    return figure


def _lateness(health: Health) -> Text:
    ticks = health["ticks"]
    late_us = {
        "p50": ticks["lateness_p50_us"],
        "p99": ticks["lateness_p99_us"],
        "max": ticks["lateness_max_us"],
    }
    shown = (f"{n} {ABSENT if us is None else f'{us / 1000:.2f}'}" for n, us in late_us.items())
    return Text("  ".join(shown))


def _counted(counts: Mapping[Any, int]) -> Text:
    listed = _listed({reason: count for reason, count in counts.items() if count})
    return Text(listed, _BAD_STYLE) if listed else Text("0")


def _listed(counts: Mapping[Any, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items())
