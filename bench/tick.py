"""One tick in the running program: snapshot to both frames handed to the kernel."""

from collections.abc import Iterator

from bench.figures import Figure, Options, counts_finely, percentile
from bench.traffic import NOMINAL_PER_S
from bench.whole import runs


def figures(options: Options) -> Iterator[Figure]:
    if not counts_finely():
        return
    took_us = [
        ns / 1e3 for ours, _ in runs(options, NOMINAL_PER_S) for ns in ours.found["tick_ns"][10:]
    ]
    middle_us = percentile(took_us, 0.5)
    yield Figure(
        "tick, processor time, median",
        "µs",
        middle_us,
        target=300,
        stretch=100,
        absolute=True,
    )
    yield Figure("tick, processor time, p99", "µs", percentile(took_us, 0.99))
    looks_us = [
        ns / 1e3 for ours, _ in runs(options, NOMINAL_PER_S) for ns in ours.found["look_ns"][10:]
    ]
    if looks_us:  # elsewhere a frame waited every time
        middle_us = percentile(looks_us, 0.5)
        yield Figure("looking for frames before a tick, none waiting, median", "µs", middle_us)
