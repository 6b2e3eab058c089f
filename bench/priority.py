"""How late the 50 ms loop wakes on a busy machine, with and without the service's policy."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from tests.processors import started_on

from bench import under_test
from bench.figures import Figure, Options, compared_tails
from bench.live import run
from bench.traffic import NOMINAL_PER_S

_FULL_S = 6.0
_TURNS = 3
_BUSY = "while True: pass"


def figures(options: Options) -> Iterator[Figure]:
    """Nothing where real-time policies are not allowed."""
    if not may_be_punctual():
        return
    seconds, turns = options.seconds(_FULL_S), options.turns(_TURNS)
    late_us: dict[str, list[list[float]]] = {"": [], "fifo": []}
    ours = under_test.gateway(under_test.HERE)
    with _busy_machine():
        for turn in range(turns):
            for option, found in late_us.items():
                live = run(ours, NOMINAL_PER_S, seconds, *filter(None, [option]))
                found.append([tick.lateness_ns / 1e3 for tick in live.ticks])
            print(f"   busy machine, turn {turn + 1} of {turns}", file=sys.stderr)
    for name, share in (("p50", 0.5), ("p99", 0.99), ("max", 1.0)):
        figure = f"tick lateness under fifo on a busy machine, {name}"
        with_policy, without = late_us["fifo"], late_us[""]
        yield compared_tails(figure, "µs", share, with_policy, without, "ordinary policy")


def may_be_punctual() -> bool:
    """Whether this user may have a real-time policy; tried in a process of its own."""
    code = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(40))"
    return subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


@contextmanager
def _busy_machine() -> Iterator[None]:
    """A busy process on each processor."""
    busy = []
    for processor in set.union(*under_test.processors()):
        with started_on({processor}):
            busy.append(subprocess.Popen([sys.executable, "-I", "-S", "-c", _BUSY]))
    try:
        yield
    finally:
        for one in busy:
            one.kill()
            one.wait()
