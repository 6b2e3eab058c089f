"""The whole gateway against the naive script: processor, memory and cadence on the wire."""

import statistics
from collections.abc import Iterator
from functools import cache

from bench.figures import Figure, Options, counts_finely, percentile
from bench.live import Cadence, Live, cadence, run
from bench.traffic import NOMINAL_PER_S, SATURATED_PER_S

_FULL_S = {NOMINAL_PER_S: 5.0, SATURATED_PER_S: 2.5}


@cache
def runs(options: Options, per_s: int) -> list[tuple[Live, Live]]:
    """Ours and the naive script in turns; kept, because several benchmarks look at them."""
    seconds = options.seconds(_FULL_S[per_s])
    return [
        (run("ours", per_s, seconds), run("naive", per_s, seconds))
        for _ in range(options.repeats(3))
    ]


def figures(options: Options) -> Iterator[Figure]:
    if counts_finely():
        yield _share(runs(options, NOMINAL_PER_S), f"{NOMINAL_PER_S} frames/s", 0.5)
        yield _share(runs(options, SATURATED_PER_S), f"{SATURATED_PER_S} frames/s", 0.4)
    turns = runs(options, NOMINAL_PER_S)
    modes = [ours.found["modes"] for ours, _ in turns]
    active = sum(mode.get("active", 0) for mode in modes) / sum(sum(m.values()) for m in modes)
    yield Figure("ticks with torque, start included", "%", 100 * active)
    memory = [(ours.resident_mb, naive.resident_mb) for ours, naive in turns]
    ours, naive = (statistics.median(column) for column in zip(*memory, strict=True))
    yield Figure("resident memory", "MB", ours, naive, "naive", 2.0, 1.3)
    yield from _cadence(
        [cadence(live.stamps_ns) for live, _ in turns],
        [cadence(live.stamps_ns) for _, live in turns],
        [cadence(live.c_stamps_ns) for live, _ in turns if live.c_stamps_ns],
        options.seconds(_FULL_S[NOMINAL_PER_S]),
    )


def _share(turns: list[tuple[Live, Live]], label: str, stretch: float) -> Figure:
    ours, naive = (
        statistics.median(live.share_pct for live in column) for column in zip(*turns, strict=True)
    )
    return Figure(f"whole program at {label}", "% of a core", ours, naive, "naive", 1.0, stretch)


def _cadence(
    ours: list[Cadence], naive: list[Cadence], by_c: list[Cadence], seconds: float
) -> Iterator[Figure]:
    off_ms = [statistics.median(c.mean_off_ms for c in who) for who in (ours, naive)]
    yield Figure("mean period on the wire, away from 50 ms", "ms", off_ms[0], off_ms[1], "naive")
    drift_ms = [max(abs(c.drift_ms) for c in who) for who in (ours, naive)]
    yield Figure(
        f"drift over {seconds:.0f} s",
        "ms",
        drift_ms[0],
        drift_ms[1],
        "naive",
        target=0.5,
        stretch=0.1,
        absolute=True,
    )
    yield Figure(
        "p99 error of the period on the wire",
        "µs",
        _p99(ours),
        _p99(by_c) if by_c else None,
        "C beside it",
        5.0,
        2.0,
    )
    yield Figure("p99 error of the period on the wire", "µs", _p99(ours), _p99(naive), "naive")
    yield Figure("cycles without a frame", "", sum(c.missed for c in ours), target=0, absolute=True)


def _p99(cycles: list[Cadence]) -> float:
    return percentile([error for one in cycles for error in one.errors_us], 0.99)
