"""What letting frames gather for a moment saves, whole program at the nominal rate."""

import statistics
from collections.abc import Iterator

from bench.figures import Figure, Options, counts_finely
from bench.live import run
from bench.traffic import NOMINAL_PER_S

_GATHER_MS = (0, 1, 4, 10, 17)
_FULL_S = 2.5


def figures(options: Options) -> Iterator[Figure]:
    if not counts_finely():
        return
    seconds = options.seconds(_FULL_S)
    turns = [
        [
            run("ours", NOMINAL_PER_S, seconds, f"--gather-ms={gather_ms}").share_pct
            for gather_ms in _GATHER_MS
        ]
        for _ in range(options.repeats(2))
    ]
    shares = [statistics.median(column) for column in zip(*turns, strict=True)]
    for gather_ms, share_pct in zip(_GATHER_MS, shares, strict=True):
        yield Figure(
            f"gathering for {gather_ms} ms", "% of a core", share_pct, shares[0], "without"
        )
