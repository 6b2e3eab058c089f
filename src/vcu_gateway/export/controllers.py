"""Commanded beside actual: what each controller was told, and what it said at that moment."""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from vcu_gateway.core.codec import Decoded
from vcu_gateway.core.spec import SignalSpec
from vcu_gateway.core.state import deadlines
from vcu_gateway.export.message_rows import MessageRows
from vcu_gateway.export.selection import Selection
from vcu_gateway.export.tables import Channel, Chunk, Table

COMMAND = re.compile(r"VCU_(\w+)_Command")
STATUS_OF_LIMIT = {"SpeedLimit": "MotorSpeed", "PowerLimit": "Power"}
"""Of Status2, what answers to a limit of the command."""
_NAN = math.nan


class LatestFrames:
    """Latest frame of one message at rising moments; None before the first, and where stale."""

    def __init__(self, rows: MessageRows) -> None:
        self._decode = rows.message.decode
        self._stale_ns = deadlines(rows.message.spec, {}, {}).stale_after_ns
        self._frames = (
            frame
            for chunk in rows.chunks()
            for frame in zip(chunk.times_ns, chunk.frames(), strict=True)
        )
        self._next = next(self._frames, None)
        self._payload: bytes | None = None
        self._stamp_ns = 0
        self._decoded: Decoded | None = None

    def at(self, moment_ns: int) -> Decoded | None:
        moved = False
        while self._next is not None and self._next[0] <= moment_ns:
            self._stamp_ns, self._payload = self._next
            self._next = next(self._frames, None)
            moved = True
        if moved and self._payload is not None:
            self._decoded = self._decode(self._payload)
        return self._decoded if moment_ns - self._stamp_ns <= self._stale_ns else None


class _Pair(NamedTuple):
    """A command's signal, and where its answer comes from: (message, value of its frame)."""

    signal: SignalSpec
    place: int
    actual: str
    unit: str
    source: MessageRows
    value: Callable[[Decoded], float]


def controllers(rows: Mapping[str, MessageRows]) -> list[str]:
    """Names of the nodes that are commanded and answer."""
    found = (COMMAND.fullmatch(name) for name in rows)
    nodes = [match[1] for match in found if match]
    return [node for node in nodes if {f"{node}_Status1", f"{node}_Status2"} <= rows.keys()]


def controller_tables(rows: Mapping[str, MessageRows], selection: Selection) -> Iterator[Table]:
    """A table for each controller, with a row for each command."""
    for node in controllers(rows):
        command = rows[f"VCU_{node}_Command"]
        pairs = [pair for pair in _pairs(node, rows) if selection.wants(node, pair.signal.name)]
        if command.count and pairs:
            channels = tuple(channel for pair in pairs for channel in _channels(pair))
            yield Table(
                *(node, "commanded, and what the controller said at that moment", channels),
                lambda command=command, pairs=pairs: _rows(command, pairs),  # type: ignore[misc]
            )


def _pairs(node: str, rows: Mapping[str, MessageRows]) -> Iterator[_Pair]:
    commanded = rows[f"VCU_{node}_Command"].message.spec.signals
    status1, status2 = rows[f"{node}_Status1"], rows[f"{node}_Status2"]
    echoed = status1.message.spec.signal_names
    for index, signal in enumerate(commanded):
        if signal.name in echoed:
            place = echoed.index(signal.name)
            yield _Pair(
                *(signal, index, signal.name, signal.unit, status1),
                lambda decoded, place=place: decoded.values[place],  # type: ignore[misc]
            )
        elif (name := STATUS_OF_LIMIT.get(signal.name)) and (value := _limited(status2, name)):
            yield _Pair(signal, index, name, signal.unit, status2, value)


def _limited(status2: MessageRows, name: str) -> Callable[[Decoded], float] | None:
    names = status2.message.spec.signal_names
    if name in names:
        place = names.index(name)
        return lambda decoded: decoded.values[place]
    if {"BatteryVoltage", "BatteryCurrent"} <= set(names):
        volt, ampere = names.index("BatteryVoltage"), names.index("BatteryCurrent")
        return lambda decoded: decoded.values[volt] * decoded.values[ampere]
    return None


def _channels(pair: _Pair) -> tuple[Channel, Channel]:
    names = pair.signal.names
    whence = f"{pair.source.message.spec.name}, NaN where it is stale"
    return (
        Channel(f"{pair.signal.name}_commanded", pair.signal.unit, names=names),
        Channel(f"{pair.actual}_actual", pair.unit, names=names, comment=whence),
    )


def _rows(command: MessageRows, pairs: list[_Pair]) -> Iterator[Chunk]:
    latest = {pair.source: LatestFrames(pair.source) for pair in pairs}
    for chunk in command.chunks():
        commanded = chunk.decoded(command.message, 0)
        answers = {
            source: [one.at(moment_ns) for moment_ns in chunk.times_ns]
            for source, one in latest.items()
        }
        columns = []
        for pair in pairs:
            value = pair.value
            found = [_NAN if one is None else value(one) for one in answers[pair.source]]
            columns += [commanded[pair.place], found]
        yield Chunk(chunk.times_ns, tuple(columns))
