"""What a benchmark finds, and how two ways are measured in turns."""

import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache

_COARSE_NS = 1_000_000


@dataclass(frozen=True)
class Figure:
    """One line of the table.

    Attributes:
        ours, peer: in `unit`, lower is better; peer is None where there is nothing to compare.
        target, stretch: limits for ours / peer, or for ours itself where `absolute`.
    """

    name: str
    unit: str
    ours: float
    peer: float | None = None
    peer_name: str = ""
    target: float | None = None
    stretch: float | None = None
    absolute: bool = False

    @property
    def ratio(self) -> float | None:
        return self.ours / self.peer if self.peer else None

    @property
    def verdict(self) -> str:
        judged = self.ours if self.absolute else self.ratio
        if self.target is None or judged is None:
            return ""
        if judged > self.target:
            return "MISSED"
        return "stretch" if self.stretch is not None and judged <= self.stretch else "target"

    def cells(self) -> list[str]:
        """The line of the table as text."""
        limit = {True: _number, False: _ratio}[self.absolute]
        return [
            self.name,
            f"{_number(self.ours)} {self.unit}",
            f"{_number(self.peer)} {self.unit} ({self.peer_name})" if self.peer is not None else "",
            _ratio(self.ratio),
            limit(self.target),
            limit(self.stretch),
            self.verdict,
        ]


HEADER = ["figure", "ours", "peer", "ratio", "target", "stretch", "verdict"]


def _number(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _ratio(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


@dataclass(frozen=True)
class Options:
    """How much time there is: 1 for the full length, less for a quick look."""

    share: float = 1.0

    def seconds(self, full_s: float) -> float:
        return max(0.8, full_s * self.share)

    def repeats(self, full: int) -> int:
        return max(1, round(full * self.share))


@cache
def counts_finely() -> bool:
    """False where the kernel counts processor time in whole ticks, as User Mode Linux does.

    Figures of processor time are left out there.
    """
    start_ns = time.process_time_ns()
    while (step_ns := time.process_time_ns() - start_ns) == 0:
        pass
    return step_ns < _COARSE_NS


def in_turns(
    ways: Mapping[str, Callable[[], object]], calls: int, repeats: int
) -> dict[str, float]:
    """Processor time of one call of each way in ns: the median of many turns A B A B ..."""
    clock_ns = time.thread_time_ns if counts_finely() else time.perf_counter_ns
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(repeats):
        for name, way in ways.items():
            before_ns = clock_ns()
            for _ in range(calls):
                way()
            times[name].append((clock_ns() - before_ns) / calls)
    return {name: statistics.median(taken) for name, taken in times.items()}


def percentile(values: list[float], share: float) -> float:
    """The value below which this share (0..1) lies; nan without values."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else float("nan")


Benchmark = Callable[[Options], Iterator[Figure]]
