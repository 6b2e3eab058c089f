"""One tick in the running program: snapshot to both frames handed to the kernel."""

from collections.abc import Iterator

from bench.figures import Figure, Options, alone, compared, counts_finely, percentile
from bench.live import Live
from bench.traffic import NOMINAL_PER_S
from bench.under_test import OTHER
from bench.whole import runs


def figures(options: Options) -> Iterator[Figure]:
    if not counts_finely():
        return
    turns, name = runs(options, NOMINAL_PER_S), "tick, processor time"
    ours_us = [_cpu_us(live, 0.5) for live in turns["ours"]]
    yield alone(f"{name}, median", "µs", ours_us, 300, 220)
    if OTHER in turns:
        other_us = [_cpu_us(live, 0.5) for live in turns[OTHER]]
        yield compared(f"{name}, median", "µs", ours_us, other_us, OTHER, 0.85)
    yield alone(f"{name}, p99", "µs", [_cpu_us(live, 0.99) for live in turns["ours"]])


def _cpu_us(live: Live, share: float) -> float:
    return percentile([tick.cpu_ns / 1e3 for tick in live.ticks], share)
