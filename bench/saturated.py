"""Whole programs on a saturated bus: processor, and what found the receive buffer full."""

from collections.abc import Iterator

from bench.figures import Figure, Options, counts_finely
from bench.traffic import SATURATED_PER_S
from bench.under_test import NAIVE
from bench.whole import Turns, runs, shares


def figures(options: Options) -> Iterator[Figure]:
    """Nothing in User Mode Linux: playing the vehicle alone would take more than there is."""
    if not counts_finely():
        return
    turns = runs(options, SATURATED_PER_S)
    yield from shares(turns, SATURATED_PER_S, 0.35, 0.2)
    yield _lost(turns)


def _lost(turns: Turns) -> Figure:
    name = f"frames lost at {SATURATED_PER_S} frames/s"
    ours, naive = (
        [1000 * live.lost / live.offered for live in turns[who] if live.lost is not None]
        for who in ("ours", NAIVE.name)
    )
    peer = max(naive) if naive else None
    return Figure(name, "‰", max(ours), peer, NAIVE.name, target=0, absolute=True)
