"""Figures: controllers, commanded beside reported; bus, ticks and API.

Formatting of values and cells; a quality is a colour and a word or mark, never colour alone.
"""

import textwrap
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

from rich.text import Text

from vcu_gateway.api.results import (
    CarriedFrame,
    ControllerCommand,
    ControllerName,
    Health,
    Message,
    QualityName,
    Signal,
    State,
)
from vcu_gateway.text import narrow_duration

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


TABLE_COLUMNS = 74
_LABEL_COLUMNS = 10
_CELL_COLUMNS = 16
_OLD_MS = 150.0
_NAMES: tuple[ControllerName, ControllerName] = ("PCU1", "PCU2")
PANEL_COLUMNS = 44
"""Least width of the panel."""

_FIGURE_COLUMNS = 17
_LINK_STYLES = {"up": "green", "error warning": "yellow"}
_BAD_STYLE = "bold yellow"


class ControllerReports:
    """Reported signals of one controller, by message kind and name."""

    def __init__(self, state: State, controller: ControllerName) -> None:
        self._messages = state["messages"]
        self._controller = controller

    def signal(self, kind: str, name: str) -> Signal | None:
        """One signal of PCUx_Status1 or PCUx_Status2; None where the gateway has none."""
        message = self._messages.get(f"{self._controller}_{kind}")
        return None if message is None else message["signals"].get(name)

    def figure(self, kind: str, name: str, decimals: int = 0, unit: str = "") -> Text:
        """Its value; what is not good is marked."""
        signal = self.signal(kind, name)
        if signal is None or signal["value"] is None:
            return Text(ABSENT, "dim")
        return marked(number(signal["value"], decimals) + unit, signal)

    def word(self, name: str) -> Text:
        """The name of a code of Status1."""
        signal = self.signal("Status1", name)
        if signal is None or signal["raw"] is None:
            return Text(ABSENT, "dim")
        return marked(signal.get("name", str(signal["raw"])), signal)

    def is_set(self, name: str) -> bool:
        """True where a flag of Status1 is anything but 0."""
        signal = self.signal("Status1", name)
        return bool(signal and signal["raw"])


class ControllerRow(NamedTuple):
    """One row of the table: label, text of the report, text of the command."""

    label: str
    reported: Callable[[ControllerReports], Text]
    commanded: Callable[[ControllerCommand], str] = lambda _: ""


def _reported_mode(reports: ControllerReports) -> Text:
    if reports.is_set("PowerCut"):
        return Text("POWER CUT", "bold red")
    return line(reports.word("PowerMode"), " ", reports.word("MotorReverse"))


def _commanded_mode(command: ControllerCommand) -> str:
    if command["power_cut"]:
        return "POWER CUT"
    return f"{command['power_mode']} {'reverse' if command['motor_reverse'] else 'forward'}"


def _commanded_brake(command: ControllerCommand) -> str:
    return f"{'regen ' if command['regen_brake'] else ''}{command['brake_pct']:.1f}"


def _reported_brake(reports: ControllerReports) -> Text:
    regen = "regen " if reports.is_set("RegenBrake") else ""
    return line(regen, reports.figure("Status1", "Brake", 1))


def _power(reports: ControllerReports) -> Text:
    """Battery voltage times battery current; the worse of the two decides its quality."""
    voltage = reports.signal("Status2", "BatteryVoltage")
    current = reports.signal("Status2", "BatteryCurrent")
    if not (voltage and current) or voltage["value"] is None or current["value"] is None:
        return Text(ABSENT, "dim")
    worse = voltage if voltage["quality"] != "good" else current
    return marked(number(voltage["value"] * current["value"]), worse)


def _battery(reports: ControllerReports) -> Text:
    voltage = reports.figure("Status2", "BatteryVoltage", 1, " V")
    return line(voltage, " ", reports.figure("Status2", "BatteryCurrent", 1, " A"))


def _temperatures(reports: ControllerReports) -> Text:
    controller = reports.figure("Status1", "ControllerTemperature")
    return line(controller, " / ", reports.figure("Status1", "MotorTemperature"))


_ROWS = (
    ControllerRow(
        "throttle %",
        lambda r: r.figure("Status1", "Throttle", 1),
        lambda c: f"{c['throttle_pct']:.1f}",
    ),
    ControllerRow("brake %", _reported_brake, _commanded_brake),
    ControllerRow("mode", _reported_mode, _commanded_mode),
    ControllerRow(
        "speed rpm",
        lambda r: r.figure("Status2", "MotorSpeed"),
        lambda c: f"max {c['speed_limit_rpm']:.0f}",
    ),
    ControllerRow("power W", _power, lambda c: f"max {c['power_limit_w']:.0f}"),
    ControllerRow("battery", _battery),
    ControllerRow("phase A", lambda r: r.figure("Status2", "PhaseCurrent", 1)),
    ControllerRow("temp degC", _temperatures),
)
_MORE_ROWS = (
    ControllerRow("protection", lambda r: r.word("TemperatureProtectLevel")),
    ControllerRow("voltage", lambda r: r.word("VoltageLevel")),
    ControllerRow("status", lambda r: r.figure("Status1", "StatusCode")),
)


def controller_lines(state: State | None, roomy: bool, old: bool = False) -> list[Text]:
    """The table; more rows where `roomy`, marked `old` while the gateway is not reachable."""
    rows = _ROWS + _MORE_ROWS if roomy else _ROWS
    lines = [_header(old), *(_line(row, state) for row in rows)]
    return [*lines, _frames(state)] if roomy else lines


def _header(old: bool) -> Text:
    heads = [head for name in _NAMES for head in (f"{name} commanded", "reported")]
    cells = [cell(head, _CELL_COLUMNS, "bold", ">") for head in heads]
    return line(cell("old values" if old else "", _LABEL_COLUMNS), *cells)


def _line(row: ControllerRow, state: State | None) -> Text:
    cells: list[Text] = []
    for name in _NAMES:
        command = state["commands"].get(name) if state else None
        cells.append(cell(row.commanded(command) if command else ABSENT, _CELL_COLUMNS, align=">"))
        reported = row.reported(ControllerReports(state, name)) if state else Text(ABSENT, "dim")
        cells.append(cell(reported, _CELL_COLUMNS, align=">"))
    return line(cell(row.label, _LABEL_COLUMNS, "dim"), *cells)


def _frames(state: State | None) -> Text:
    """The bytes that the kernel took last, as candump writes them."""
    cells = [cell("frame", _LABEL_COLUMNS, "dim")]
    for name in _NAMES:
        command = state["commands"].get(name) if state else None
        frame = _sent(command["sent"]) if command else ABSENT
        cells.append(cell(frame, 2 * _CELL_COLUMNS, align=">"))
    return line(*cells)


def _sent(frame: CarriedFrame | None) -> str:
    if frame is None:
        return "nothing sent"
    is_old = frame["age_ms"] > _OLD_MS
    return f"{frame['frame']} {narrow_duration(frame['age_ms'])}" if is_old else frame["frame"]


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
    lost = health["link"]["lost"]
    rows = [
        ("bus", _link(health, " for ") if lost is None else Text(lost, "red")),
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


def _link(health: Health, between: str = " ") -> Text:
    link = health["link"]
    style = _LINK_STYLES.get(link["state"], "bold red")
    return Text(f"{link['state']}{between}{narrow_duration(link['since_ms'])}", style)


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
