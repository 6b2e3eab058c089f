"""Bus to store: processor time of a frame from the socket to where the tick finds it, no ticks."""

import sys
import time
from collections.abc import Iterator

from bench import under_test
from bench.figures import Figure, Options, compared, counts_finely
from bench.live import started
from bench.traffic import NOMINAL_PER_S, SATURATED_PER_S
from bench.under_test import NAIVE, OTHER, Program
from bench.wire import Wire, cpu_ns

_TURNS = 5
_FULL_S = 1.5
_WARM_UP_S = 0.3


def figures(options: Options) -> Iterator[Figure]:
    if not counts_finely():
        return
    programs = [
        *under_test.gateways(options, way="receive"),
        Program(NAIVE.name, (*NAIVE.words, "silent")),
    ]
    for per_s in (NOMINAL_PER_S, SATURATED_PER_S):
        turns = options.turns(_TURNS)
        found: dict[str, list[float]] = {program.name: [] for program in programs}
        for turn in range(turns):
            for program in programs if turn % 2 == 0 else reversed(programs):
                found[program.name].append(_us_per_frame(program, per_s, options))
            print(f"   {per_s} frames/s, turn {turn + 1} of {turns}", file=sys.stderr)
        name, ours = f"bus to store, a frame, {per_s} frames/s", found["ours"]
        yield compared(name, "µs", ours, found[NAIVE.name], NAIVE.name, 0.8, 0.4)
        if OTHER in found:
            yield compared(name, "µs", ours, found[OTHER], OTHER)


def _us_per_frame(program: Program, per_s: float, options: Options) -> float:
    with Wire(per_s) as wire, started(wire, program) as running:
        child = running.process
        assert child.stdout is not None
        child.stdout.readline()  # it is ready
        time.sleep(_WARM_UP_S)
        sent, before_ns = wire.sent, cpu_ns(child.pid)
        time.sleep(options.seconds(_FULL_S))
        return (cpu_ns(child.pid) - before_ns) / (wire.sent - sent) / 1e3
