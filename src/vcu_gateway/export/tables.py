"""Tables of an export: decoded messages, commanded beside actual, and what the gateway decided.

Commanded beside actual: what each controller was told, and what it said at that moment.
"""

import math
import re
from array import array
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from vcu_gateway.core.codec import Decoded
from vcu_gateway.core.spec import SignalSpec
from vcu_gateway.core.state import deadlines
from vcu_gateway.export.decisions import MODES, Decisions
from vcu_gateway.export.frame_store import CHUNK_ROWS, MessageRows, RowChunk
from vcu_gateway.export.source import Selection

GATEWAY = "Gateway"
"""Table of modes and causes; events and `why` have tables with it as the begin of their names."""

Column = Sequence[float] | Sequence[str]


class Channel(NamedTuple):
    """One column of a table.

    Attributes:
        kind: "int", "float" (NaN where there is no value) or "text".
        names: names of the values of an enumeration.
        factor, offset: physical = raw * factor + offset, where the raw codes are given.
        raw_bits: width of the raw codes, negative where they are signed; 0 where there are none.
    """

    name: str
    unit: str = ""
    kind: str = "float"
    names: Mapping[int, str] = {}
    comment: str = ""
    factor: float = 1.0
    offset: float = 0.0
    raw_bits: int = 0


class Chunk(NamedTuple):
    """Some rows: a stamp for each, and a column for each channel."""

    times_ns: "array[int]"
    columns: tuple[Column, ...]


class Table(NamedTuple):
    """One table; `chunks` gives its rows from the first on, as often as it is called.

    Attributes:
        raw_chunks: the same with the codes on the wire; None where there are none.
    """

    name: str
    comment: str
    channels: tuple[Channel, ...]
    chunks: Callable[[], Iterator[Chunk]]
    raw_chunks: Callable[[], Iterator[Chunk]] | None = None


def message_tables(rows: Iterable[MessageRows], selection: Selection) -> Iterator[Table]:
    """A table for each message of which there are frames and a signal is asked for."""
    for one in rows:
        spec = one.message.spec
        wanted = [i for i, name in enumerate(spec.signal_names) if selection.wants(spec.name, name)]
        if wanted and one.count:
            yield _message_table(one, wanted)


def _message_table(rows: MessageRows, wanted: list[int]) -> Table:
    spec = rows.message.spec
    channels = tuple(signal_channel(spec.signals[i]) for i in wanted)
    return Table(
        spec.name,
        spec.comment,
        channels,
        lambda: (_decoded(rows, chunk, wanted, 0) for chunk in rows.chunks()),
        lambda: (_decoded(rows, chunk, wanted, 1) for chunk in rows.chunks()),
    )


def signal_channel(signal: SignalSpec) -> Channel:
    whole = float(signal.factor).is_integer() and float(signal.offset).is_integer()
    described = signal.name, signal.unit, "int" if whole else "float", signal.names, signal.comment
    raw_bits = -signal.length_bits if signal.signed else signal.length_bits
    return Channel(*described, signal.factor, signal.offset, raw_bits)


def _decoded(rows: MessageRows, chunk: RowChunk, wanted: list[int], part: int) -> Chunk:
    """Columns of a chunk; part 0 of what is decoded are the values, 1 the codes."""
    columns = chunk.decoded(rows.message, part)
    return Chunk(chunk.times_ns, tuple(columns[i] for i in wanted))


def decision_tables(decisions: Decisions, selection: Selection) -> Iterator[Table]:
    """Modes and causes at each tick, events, `why`, and gaps of the recording."""
    if decisions.tick_times_ns:
        yield from _tick_table(decisions, selection)
    events = [(one.wall_ns, (one.name, one.severity, one.text)) for one in decisions.events]
    yield from _texts("Events", ("Event", "Severity", "Detail"), events, selection)
    for name, channel, texts in (
        ("Why", "Sentence", decisions.whys),
        ("Gaps", "Missing", decisions.gaps),
    ):
        rows = [(stamp, (text,)) for stamp, text in texts]
        yield from _texts(name, (channel,), rows, selection)


def _tick_table(decisions: Decisions, selection: Selection) -> Iterator[Table]:
    times_ns = decisions.tick_times_ns
    columns: list[tuple[Channel, Sequence[float]]] = []
    if selection.wants(GATEWAY, "Mode"):
        mode = Channel("Mode", kind="int", names=dict(enumerate(MODES)), comment="operating mode")
        columns.append((mode, decisions.tick_modes))
    spans: dict[str, list[tuple[int, int]]] = {}
    for span in decisions.causes:
        last = len(times_ns) if span.ended_ns is None else bisect_left(times_ns, span.ended_ns)
        reach = bisect_left(times_ns, span.began_ns), last
        spans.setdefault(span.key.title, []).append(reach)
    for name, reaches in spans.items():
        if selection.wants(GATEWAY, name):
            stands = array("b", bytes(len(times_ns)))
            for first, last in reaches:
                stands[first:last] = array("b", b"\1" * (last - first))
            columns.append((Channel(name, kind="int", comment="1 while the cause counts"), stands))
    if columns:
        channels = tuple(channel for channel, _ in columns)
        parts = [column for _, column in columns]
        yield Table(
            *(GATEWAY, "what the gateway decided at each tick", channels),
            lambda: _sliced(times_ns, parts),
        )


def _sliced(times_ns: "array[int]", columns: Sequence[Column]) -> Iterator[Chunk]:
    for first in range(0, len(times_ns), CHUNK_ROWS):
        part = slice(first, first + CHUNK_ROWS)
        yield Chunk(times_ns[part], tuple(column[part] for column in columns))


def _texts(
    name: str,
    channels: tuple[str, ...],
    rows: Sequence[tuple[int, tuple[str, ...]]],
    selection: Selection,
) -> Iterator[Table]:
    table = f"{GATEWAY}_{name}"
    wanted = [i for i, channel in enumerate(channels) if selection.wants(table, channel)]
    if not (wanted and rows):
        return
    times_ns = array("q", [stamp for stamp, _ in rows])
    columns = [[texts[i] for _, texts in rows] for i in wanted]
    kept = tuple(Channel(channels[i], kind="text") for i in wanted)
    yield Table(table, f"{name.lower()} of the gateway", kept, lambda: _sliced(times_ns, columns))


COMMAND = re.compile(r"VCU_(\w+)_Command")
STATUS_OF_LIMIT = {"SpeedLimit": "MotorSpeed", "PowerLimit": "Power"}
"""Of Status2, what answers to a limit of the command."""


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
        self._stamp_ns = 0
        self._decoded: Decoded | None = None

    def at(self, moment_ns: int) -> Decoded | None:
        payload: bytes | None = None
        while self._next is not None and self._next[0] <= moment_ns:
            self._stamp_ns, payload = self._next
            self._next = next(self._frames, None)
        if payload is not None:
            self._decoded = self._decode(payload)
        return self._decoded if moment_ns - self._stamp_ns <= self._stale_ns else None


class _Pair(NamedTuple):
    """A command's signal, and where its answer comes from: (message, value of its frame)."""

    signal: SignalSpec
    place: int
    actual: str
    source: MessageRows
    value: Callable[[Decoded], float]


def controller_tables(rows: Mapping[str, MessageRows], selection: Selection) -> Iterator[Table]:
    """A table for each node that is commanded and answers, with a row for each command."""
    nodes = {match[1]: one for name, one in rows.items() if (match := COMMAND.fullmatch(name))}
    for node, command in nodes.items():
        if not {f"{node}_Status1", f"{node}_Status2"} <= rows.keys():
            continue
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
        source, name = status1, signal.name
        if name not in echoed:
            source, name = status2, STATUS_OF_LIMIT.get(name, "")
        if name and (value := _answer(source, name)):
            yield _Pair(signal, index, name, source, value)


def _answer(status: MessageRows, name: str) -> Callable[[Decoded], float] | None:
    """The signal of this name, else the power that voltage and current give; None without."""
    names = status.message.spec.signal_names
    if name in names:
        place = names.index(name)
        return lambda decoded: decoded.values[place]
    if {"BatteryVoltage", "BatteryCurrent"} <= set(names):
        volt, ampere = names.index("BatteryVoltage"), names.index("BatteryCurrent")
        return lambda decoded: decoded.values[volt] * decoded.values[ampere]
    return None


def _channels(pair: _Pair) -> tuple[Channel, Channel]:
    names, unit = pair.signal.names, pair.signal.unit
    whence = f"{pair.source.message.spec.name}, NaN where it is stale"
    return (
        Channel(f"{pair.signal.name}_commanded", unit, names=names),
        Channel(f"{pair.actual}_actual", unit, names=names, comment=whence),
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
            found = [math.nan if one is None else value(one) for one in answers[pair.source]]
            columns += [commanded[pair.place], found]
        yield Chunk(chunk.times_ns, tuple(columns))
