"""Plots of a report: commanded and actual of each controller first, then other signals by unit.

Lines of a recording's signals on the report's grid.
"""

import math
import re
from array import array
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import NamedTuple

from vcu_gateway.core.spec import SignalSpec
from vcu_gateway.core.state import deadlines
from vcu_gateway.export.frame_store import MessageRows
from vcu_gateway.export.report import (
    GAP,
    LARGEST_CODE,
    CodeLine,
    Line,
    LineBuilder,
    Overlay,
    Plot,
    Role,
)
from vcu_gateway.export.source import Selection
from vcu_gateway.export.tables import STATUS_OF_LIMIT
from vcu_gateway.units import NS_PER_MS

_LARGEST_BITS = 31


class Grid(NamedTuple):
    """Common grid of every line."""

    start_ns: int
    bucket_ns: int
    buckets: int

    def bucket(self, stamp_ns: int) -> int:
        """Bucket of a moment, the last one for what comes later."""
        return min(max(0, (stamp_ns - self.start_ns) // self.bucket_ns), self.buckets - 1)


class SignalLine(NamedTuple):
    """Line of one signal."""

    message: str
    signal: SignalSpec
    codes: CodeLine

    @property
    def key(self) -> str:
        """`Message.Signal`."""
        return f"{self.message}.{self.signal.name}"


def signal_lines(
    rows: Iterable[MessageRows], selection: Selection, grid: Grid
) -> Iterator[SignalLine]:
    for one in rows:
        spec = one.message.spec
        wanted = [
            index
            for index, signal in enumerate(spec.signals)
            if selection.wants(spec.name, signal.name) and signal.length_bits <= _LARGEST_BITS
        ]
        if wanted and one.count:
            for index, line in zip(wanted, _lines(one, wanted, grid), strict=True):
                yield SignalLine(spec.name, spec.signals[index], line)


def _lines(rows: MessageRows, wanted: list[int], grid: Grid) -> list[CodeLine]:
    builders = [LineBuilder(grid.buckets) for _ in wanted]
    for chunk in rows.chunks():
        columns = chunk.decoded(rows.message, 1)
        buckets = [grid.bucket(stamp) for stamp in chunk.times_ns]
        for builder, index in zip(builders, wanted, strict=True):
            builder.add(buckets, columns[index])
    stale_ns = deadlines(rows.message.spec, {}, {}).stale_after_ns
    return [builder.line(stale_ns // grid.bucket_ns + 1) for builder in builders]


def product(first: SignalLine, second: SignalLine) -> CodeLine:
    """Product of two signals' values at each moment, in whole units."""

    def times(one: int, other: int) -> int:
        if one == GAP or other == GAP:
            return GAP
        value = _value(first.signal, one) * _value(second.signal, other)
        return round(min(max(value, -LARGEST_CODE), LARGEST_CODE))

    pairs = zip(first.codes, second.codes, strict=True)
    return CodeLine(*(array("i", map(times, one, other)) for one, other in pairs))


def _value(signal: SignalSpec, code: int) -> float:
    return code * signal.factor + signal.offset


_MOST_LINES = 6
_COMMAND = re.compile(r"VCU_(\w+)_Command\.(\w+)")
_TITLES = {
    "Throttle": "throttle",
    "Brake": "brake",
    "SpeedLimit": "motor speed and its limit",
    "PowerLimit": "electrical power and its limit",
    "PowerMode": "power mode",
    "MotorReverse": "direction",
    "RegenBrake": "regeneration",
    "PowerCut": "power cut",
}
_FIRST = ("Throttle", "SpeedLimit", "PowerLimit", "Brake")
_OVERLAY_HOLD_NS = 200 * NS_PER_MS


def plots(
    lines: Mapping[str, SignalLine], overlay: Overlay | None, grid: Grid
) -> tuple[tuple[Plot, ...], tuple[tuple[str, str], ...]]:
    """Every plot in which something changes, and the signals that never do, with their value."""
    used: set[str] = set()
    found = [*_controller_plots(lines, overlay, grid, used), *_other_plots(lines, used)]
    constant = tuple(
        (key, _text(line.signal, code))
        for key, line in lines.items()
        if (code := line.codes.constant) is not None
    )
    return tuple(plot for plot in found if _moves(plot)), constant


def _moves(plot: Plot) -> bool:
    """Whether a line changes, or two that belong together differ."""
    constants = {line.codes.constant for line in plot.lines if not line.codes.empty}
    paired = plot.lines[0].role is not Role.SIGNAL
    return None in constants or (paired and len(constants) > 1)


def _text(signal: SignalSpec, code: int) -> str:
    value = f"{round(_value(signal, code), 6):g} {signal.unit}".strip()
    return signal.names.get(code, value)


def _controller_plots(
    lines: Mapping[str, SignalLine], overlay: Overlay | None, grid: Grid, used: set[str]
) -> Iterator[Plot]:
    commands = [match for key in lines if (match := _COMMAND.fullmatch(key))]
    order = {name: place for place, name in enumerate(_FIRST)}
    commands.sort(key=lambda match: (order.get(match[2], len(order)), match[1]))
    for match in commands:
        key, node, name = match[0], match[1], match[2]
        answer = _answer(lines, node, name)
        commanded = lines[key]
        label = "limit" if name in STATUS_OF_LIMIT else "commanded"
        parts = [_line(label, Role.COMMANDED, commanded)]
        if overlay is not None and key in overlay.series:
            codes = overlay_codes(overlay, key, commanded.signal, grid)
            parts.append(_line("what if", Role.WHAT_IF, commanded)._replace(codes=codes))
        if answer is not None:
            parts.append(answer)
            used.add(f"{node}_Status1.{name}")
            used.add(f"{node}_Status2.{STATUS_OF_LIMIT.get(name, name)}")
        used.add(key)
        yield Plot(f"{node} {_TITLES.get(name, name)}", commanded.signal.unit, tuple(parts))


def _answer(lines: Mapping[str, SignalLine], node: str, name: str) -> Line | None:
    """What the controller says to a signal of its command."""
    status2 = f"{node}_Status2"
    volt, ampere = lines.get(f"{status2}.BatteryVoltage"), lines.get(f"{status2}.BatteryCurrent")
    if name == "PowerLimit" and volt is not None and ampere is not None:
        return Line("voltage × current", Role.ACTUAL, product(volt, ampere))
    answer = f"{status2}.{STATUS_OF_LIMIT[name]}" if name in STATUS_OF_LIMIT else ""
    found = lines.get(answer or f"{node}_Status1.{name}")
    if found is None:
        return None
    label = "motor speed" if name == "SpeedLimit" else "controller says"
    return _line(label, Role.ACTUAL, found)._replace(steps=name not in STATUS_OF_LIMIT)


def _line(label: str, role: Role, line: SignalLine) -> Line:
    signal = line.signal
    steps = role is not Role.SIGNAL or bool(signal.names)
    return Line(label, role, line.codes, signal.factor, signal.offset, signal.names, steps)


def overlay_codes(overlay: Overlay, key: str, signal: SignalSpec, grid: Grid) -> CodeLine:
    """Line of the what-if on the same grid, as raw codes."""
    builder = LineBuilder(grid.buckets)
    known = [
        (grid.bucket(stamp), round((value - signal.offset) / signal.factor))
        for stamp, value in zip(overlay.times_ns, overlay.series[key], strict=True)
        if not math.isnan(value)
    ]
    builder.add([bucket for bucket, _ in known], [code for _, code in known])
    return builder.line(_OVERLAY_HOLD_NS // grid.bucket_ns + 1)


def _other_plots(lines: Mapping[str, SignalLine], used: set[str]) -> Iterator[Plot]:
    """Signals of one message and one unit together; what has names is a band, not a line."""
    left = [
        line
        for key, line in lines.items()
        if key not in used and not line.signal.names and line.codes.constant is None
    ]
    left = [line for line in left if not line.codes.empty and line.signal.length_bits > 1]
    left.sort(key=_kind)
    for (message, unit), group in groupby(left, key=lambda line: (line.message, line.signal.unit)):
        together = list(group)
        for first in range(0, len(together), _MOST_LINES):
            part = together[first : first + _MOST_LINES]
            names = [line.signal.name for line in part]
            title = f"{message.replace('_', ' ')}: {_common(names)}"
            yield Plot(
                title, unit, tuple(_line(line.signal.name, Role.SIGNAL, line) for line in part)
            )


def _kind(line: SignalLine) -> tuple[int, str, str]:
    """Battery and controllers before the wheels, the inertial unit at the end."""
    orders = ("PCU", "BMS", "ARD")
    place = next((i for i, one in enumerate(orders) if line.message.startswith(one)), len(orders))
    return place, line.message, line.signal.unit


def _common(names: Sequence[str]) -> str:
    """`WheelSpeed` of WheelSpeedFL and WheelSpeedFR; else both names."""
    start = names[0]
    for name in names:
        while not name.startswith(start):
            start = start[:-1]
    spaced = start.rstrip("_0123456789")
    name = spaced if len(spaced) > 3 else ", ".join(names)
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()
