"""How late the 50 ms loop wakes, beside a C program that wakes once a tick."""

from collections.abc import Iterator

from bench.figures import Figure, Options, alone, compared, percentile
from bench.live import Live
from bench.traffic import NOMINAL_PER_S
from bench.under_test import C_A_TICK, OTHER
from bench.whole import runs


def figures(options: Options) -> Iterator[Figure]:
    turns = runs(options, NOMINAL_PER_S)
    peers = [peer for peer in (C_A_TICK.name, OTHER) if peer in turns]
    for name, share in (("p50", 0.5), ("p99", 0.99), ("max", 1.0)):
        ours_us, *others_us = (
            [_late_us(live, share) for live in turns[who]] for who in ("ours", *peers)
        )
        if not peers:
            yield alone(f"tick lateness, {name}", "µs", ours_us)
        for peer, other_us in zip(peers, others_us, strict=True):
            yield compared(f"tick lateness, {name}", "µs", ours_us, other_us, peer)


def _late_us(live: Live, share: float) -> float:
    return percentile([tick.lateness_ns / 1e3 for tick in live.ticks], share)
