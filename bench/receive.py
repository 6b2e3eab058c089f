"""Bus to store: processor time of a frame from the socket to where the tick finds it."""

import json
import statistics
from collections.abc import Iterator

from bench.figures import Figure, Options, counts_finely
from bench.live import started
from bench.traffic import NOMINAL_PER_S, SATURATED_PER_S
from bench.wire import Wire

_RATES = {
    f"{NOMINAL_PER_S} frames/s": (NOMINAL_PER_S, ()),
    f"{SATURATED_PER_S} frames/s": (SATURATED_PER_S, ()),
    # The buffer is always full here: gathering would only empty the caches.
    "flooded": (None, ("--gather-ms=0",)),
}
_FULL_S = 1.5


def figures(options: Options) -> Iterator[Figure]:
    for label, (per_s, extra) in _RATES.items():
        if per_s != SATURATED_PER_S and not counts_finely():
            continue  # too little to count in whole ticks, or too slow to be flooded
        turns = [
            [us_per_frame(f"receive-{who}", per_s, options, *extra) for who in ("ours", "naive")]
            for _ in range(options.repeats(3))
        ]
        ours, naive = (statistics.median(column) for column in zip(*turns, strict=True))
        yield Figure(f"bus to store, a frame, {label}", "µs", ours, naive, "naive", 0.8, 0.4)


def us_per_frame(program: str, per_s: float | None, options: Options, *extra: str) -> float:
    seconds = f"--seconds={options.seconds(_FULL_S)}"
    with Wire(per_s) as wire, started(wire, program, seconds, *extra) as child:
        found: dict[str, float] = json.loads(child.communicate(timeout=60)[0])
    return found["cpu_ns"] / found["frames"] / 1e3
