"""Table of the controllers: commanded beside reported values."""

from collections.abc import Callable
from typing import NamedTuple

from rich.text import Text

from vcu_gateway.api.results import CarriedFrame, ControllerCommand, ControllerName, Signal, State
from vcu_gateway.text import narrow_duration
from vcu_gateway.watch.formatting import ABSENT, cell, line, marked, number

COLUMNS = 74
"""Width of the table."""

_LABEL_COLUMNS = 10
_CELL_COLUMNS = 16
_OLD_MS = 150.0
_NAMES: tuple[ControllerName, ControllerName] = ("PCU1", "PCU2")


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
