"""What a benchmark finds, and how two ways are measured in turns."""

import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

_COARSE_NS = 1_000_000


@dataclass(frozen=True)
class Figure:
    """One line of the table.

    Attributes:
        ours, peer: in `unit`, lower is better; peer is None where there is nothing to compare.
        target, stretch: limits for ours / peer, or for ours itself where `absolute`.
        ratio: ours / peer; of figures measured in turns, the median of the turns' ratios.
        spread: quartiles of the turns: of the ratio, or of ours where there is no peer.
    """

    name: str
    unit: str
    ours: float
    peer: float | None = None
    peer_name: str = ""
    target: float | None = None
    stretch: float | None = None
    absolute: bool = False
    ratio: float | None = None
    spread: tuple[float, float] | None = None

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
        limit = _number if self.absolute else _ratio
        beside = "" if self.peer is None else f"{_with_unit(self.peer, self.unit)}"
        spread = "" if self.spread is None else " … ".join(
            map(_number if self.ratio is None else _ratio, self.spread)
        )  # fmt: skip
        return [
            self.name,
            _with_unit(self.ours, self.unit),
            f"{beside} ({self.peer_name})" if beside else "",
            _ratio(self.ratio),
            spread,
            limit(self.target),
            limit(self.stretch),
            self.verdict,
        ]


HEADER = ["figure", "ours", "peer", "ratio", "spread", "target", "stretch", "verdict"]


def compared(
    name: str,
    unit: str,
    ours: Sequence[float],
    peer: Sequence[float],
    peer_name: str,
    target: float | None = None,
    stretch: float | None = None,
) -> Figure:
    """Two ways that ran in turns, a value of each for every turn."""
    ratios = [one / other for one, other in zip(ours, peer, strict=True) if other]
    return Figure(
        name,
        unit,
        statistics.median(ours),
        statistics.median(peer),
        peer_name,
        target,
        stretch,
        ratio=statistics.median(ratios) if ratios else None,
        spread=quartiles(ratios) if ratios else None,
    )


def compared_tails(
    name: str,
    unit: str,
    share: float,
    ours: Sequence[Sequence[float]],
    peer: Sequence[Sequence[float]],
    peer_name: str,
    target: float | None = None,
    stretch: float | None = None,
) -> Figure:
    """Percentiles of two ways that ran in turns: of all values, since a turn has too few.

    The spread is that of the turns by themselves.
    """
    of_turns = [[percentile(turn, share) for turn in way] for way in (ours, peer)]
    of_all = [percentile([value for turn in way for value in turn], share) for way in (ours, peer)]
    figure = compared(name, unit, of_turns[0], of_turns[1], peer_name, target, stretch)
    ratio = of_all[0] / of_all[1] if of_all[1] else None
    return replace(figure, ours=of_all[0], peer=of_all[1], ratio=ratio)


def alone(
    name: str,
    unit: str,
    ours: Sequence[float],
    target: float | None = None,
    stretch: float | None = None,
) -> Figure:
    """Ours without a peer, a value for every turn."""
    middle, spread = statistics.median(ours), quartiles(ours)
    return Figure(name, unit, middle, target=target, stretch=stretch, absolute=True, spread=spread)


def quartiles(values: Sequence[float]) -> tuple[float, float]:
    """The limits between which the middle half of these values lies."""
    if len(values) < 2:
        return values[0], values[0]
    lower, _, upper = statistics.quantiles(values, n=4, method="inclusive")
    return lower, upper


def _number(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _ratio(value: float | None) -> str:
    return "" if value is None else f"{value:.2f}"


def _with_unit(value: float, unit: str) -> str:
    return f"{_number(value)} {unit}".rstrip()


@dataclass(frozen=True)
class Options:
    """How much time there is, and what else is measured.

    Attributes:
        share: 1 for the full length, less for a quick look.
        against: another source tree, run in turns with this one.
    """

    share: float = 1.0
    against: Path | None = None

    def seconds(self, full_s: float) -> float:
        return max(0.8, full_s * self.share)

    def repeats(self, full: int) -> int:
        return max(1, round(full * self.share))

    def turns(self, full: int) -> int:
        """Of programs: at least three, or their spread says nothing."""
        return max(min(3, full), round(full * self.share))


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
) -> dict[str, list[float]]:
    """Processor time of one call of each way in ns, for each of many turns A B A B ..."""
    clock_ns = time.thread_time_ns if counts_finely() else time.perf_counter_ns
    times: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(repeats):
        for name, way in ways.items():
            before_ns = clock_ns()
            for _ in range(calls):
                way()
            times[name].append((clock_ns() - before_ns) / calls)
    return times


def percentile(values: Sequence[float], share: float) -> float:
    """The value below which this share (0..1) lies; nan without values."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else float("nan")


Benchmark = Callable[[Options], Iterator[Figure]]
