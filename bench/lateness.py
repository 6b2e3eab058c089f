"""How late the 50 ms loop wakes, beside a C program that wakes once a tick."""

from collections.abc import Iterator

from bench.figures import Figure, Options, compared_tails
from bench.live import Live
from bench.traffic import NOMINAL_PER_S
from bench.under_test import C_A_TICK, OTHER
from bench.whole import runs


def figures(options: Options) -> Iterator[Figure]:
    turns = runs(options, NOMINAL_PER_S)
    for name, share in (("p50", 0.5), ("p99", 0.99), ("max", 1.0)):
        for peer in (C_A_TICK.name, OTHER):
            if peer in turns:
                ours_us, peer_us = (
                    [_late_us(live) for live in turns[who]] for who in ("ours", peer)
                )
                yield compared_tails(f"tick lateness, {name}", "µs", share, ours_us, peer_us, peer)


def _late_us(live: Live) -> list[float]:
    return [tick.lateness_ns / 1e3 for tick in live.ticks]
