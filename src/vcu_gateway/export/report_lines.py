"""Lines of a recording's signals on the report's grid."""

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from vcu_gateway.core.spec import SignalSpec
from vcu_gateway.core.state import deadlines
from vcu_gateway.export.lines import GAP, LARGEST_CODE, CodeLine, LineBuilder
from vcu_gateway.export.message_rows import MessageRows
from vcu_gateway.export.selection import Selection

_LARGEST_BITS = 31


class Grid(NamedTuple):
    """Common grid of every line."""

    start_ns: int
    bucket_ns: int
    buckets: int

    def bucket(self, stamp_ns: int) -> int:
        """Bucket of a moment, the last one for what comes later."""
        return min(max(0, (stamp_ns - self.start_ns) // self.bucket_ns), self.buckets - 1)

    def hold_buckets(self, rows: MessageRows) -> int:
        """How long a value of this message counts."""
        stale_ns = deadlines(rows.message.spec, {}, {}).stale_after_ns
        return min(self.buckets, stale_ns // self.bucket_ns + 1)


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
            lines = _lines(one, wanted, grid)
            yield from (
                SignalLine(spec.name, spec.signals[index], line)
                for index, line in zip(wanted, lines, strict=True)
            )


def _lines(rows: MessageRows, wanted: list[int], grid: Grid) -> list[CodeLine]:
    builders = [LineBuilder(grid.buckets) for _ in wanted]
    start_ns, bucket_ns, last = grid.start_ns, grid.bucket_ns, grid.buckets - 1
    for chunk in rows.chunks():
        columns = chunk.decoded(rows.message, 1)
        buckets = [min(max(0, (one - start_ns) // bucket_ns), last) for one in chunk.times_ns]
        for builder, index in zip(builders, wanted, strict=True):
            builder.add(buckets, columns[index])
    hold = grid.hold_buckets(rows)
    return [builder.line(hold) for builder in builders]


def product(first: SignalLine, second: SignalLine) -> CodeLine:
    """Product of two signals' values at each moment, in whole units."""

    def times(one: int, other: int) -> int:
        if one == GAP or other == GAP:
            return GAP
        value = _value(first.signal, one) * _value(second.signal, other)
        return round(min(max(value, -LARGEST_CODE), LARGEST_CODE))

    return CodeLine(
        type(first.codes.earlier)("i", map(times, first.codes.earlier, second.codes.earlier)),
        type(first.codes.later)("i", map(times, first.codes.later, second.codes.later)),
    )


def _value(signal: SignalSpec, code: int) -> float:
    return code * signal.factor + signal.offset


def by_key(lines: Iterable[SignalLine]) -> Mapping[str, SignalLine]:
    return {line.key: line for line in lines}
