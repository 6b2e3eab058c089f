"""Report of a recording as values: what one page shows, without how it is drawn."""

from collections.abc import Mapping, Sequence
from enum import Enum
from typing import NamedTuple

from vcu_gateway.export.lines import CodeLine


class Role(Enum):
    """Role of a line in its plot."""

    COMMANDED = "commanded"
    ACTUAL = "actual"
    WHAT_IF = "what if"
    SIGNAL = "signal"


class Line(NamedTuple):
    """One line of a plot: raw codes, of which physical = code * factor + offset.

    Attributes:
        steps: held from each value to the next, not joined by slopes.
    """

    label: str
    role: Role
    codes: CodeLine
    factor: float = 1.0
    offset: float = 0.0
    names: Mapping[int, str] = {}
    steps: bool = False


class Plot(NamedTuple):
    """Lines of one unit over time."""

    title: str
    unit: str
    lines: tuple[Line, ...]


class Span(NamedTuple):
    """Stretch of a band; `kind` is a mode, an effect, or empty."""

    begin_ns: int
    end_ns: int
    kind: str
    text: str


class Band(NamedTuple):
    """Row of stretches above the plots."""

    title: str
    spans: tuple[Span, ...]
    what_if: bool = False


class ReportEvent(NamedTuple):
    """Row of the table of events; `severity` is a level of the log."""

    wall_ns: int
    severity: str
    name: str
    text: str


class Overlay(NamedTuple):
    """Answer of a replay with another configuration, laid over a recording.

    Attributes:
        headline: what would have been different, in a sentence.
        notes: further sentences, such as that the recorded vehicle does not react.
        columns, rows: table of what differs, as texts.
        times_ns: wall time of each tick.
        series: "VCU_PCU1_Command.Throttle" -> value at each tick, NaN where no frame was sent.
        modes: wall time and the mode from there on.
        causes: text, begin and end of each; the end is None where it counts at the end.
    """

    headline: str
    notes: tuple[str, ...] = ()
    columns: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    times_ns: Sequence[int] = ()
    series: Mapping[str, Sequence[float]] = {}
    modes: Sequence[tuple[int, str]] = ()
    causes: Sequence[tuple[str, int, int | None]] = ()


class Report(NamedTuple):
    """Everything that a page shows.

    Attributes:
        headline: the drive in a sentence.
        facts: name and value, the most important first.
        bucket_ns, buckets: the grid of every line.
        constant: signals that never changed, and their value.
        texts: attached files, by name.
    """

    title: str
    headline: str
    facts: tuple[tuple[str, str], ...]
    start_ns: int
    end_ns: int
    bucket_ns: int
    buckets: int
    plots: tuple[Plot, ...]
    bands: tuple[Band, ...]
    events: tuple[ReportEvent, ...]
    whys: tuple[tuple[int, str], ...]
    constant: tuple[tuple[str, str], ...]
    texts: Mapping[str, str]
    overlay: Overlay | None = None
