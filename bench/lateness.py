"""How late the 50 ms loop wakes, beside a C program that only sleeps."""

from collections.abc import Iterator

from bench.figures import Figure, Options, percentile
from bench.traffic import NOMINAL_PER_S
from bench.whole import runs


def figures(options: Options) -> Iterator[Figure]:
    turns = [ours for ours, _ in runs(options, NOMINAL_PER_S)]
    ours_us = [ns / 1e3 for live in turns for ns in live.found["lateness_ns"][10:]]
    c_us = [ns / 1e3 for live in turns for ns in live.c_late_ns]
    for name, share in (("p50", 0.5), ("p99", 0.99), ("max", 1.0)):
        floor = percentile(c_us, share) if c_us else None
        yield Figure(
            f"tick lateness, {name}", "µs", percentile(ours_us, share), floor, "C beside it"
        )
