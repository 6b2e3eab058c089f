"""How late the 50 ms loop wakes on a busy machine, with and without the service's policy."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from bench.figures import Figure, Options, percentile
from bench.live import run
from bench.traffic import NOMINAL_PER_S

_FULL_S = 8.0
_BUSY = "while True: pass"


def figures(options: Options) -> Iterator[Figure]:
    """Nothing where real-time policies are not allowed."""
    if not may_be_punctual():
        return
    seconds = options.seconds(_FULL_S)
    late_us: dict[str, list[float]] = {"": [], "--fifo": []}
    with _busy_machine():
        for _ in range(options.repeats(3)):
            for option, found in late_us.items():
                live = run("ours", NOMINAL_PER_S, seconds, *filter(None, [option]))
                found += [ns / 1e3 for ns in live.found["lateness_ns"][10:]]
    for name, share in (("p50", 0.5), ("p99", 0.99), ("max", 1.0)):
        with_policy, without = (percentile(late_us[key], share) for key in ("--fifo", ""))
        yield Figure(
            f"tick lateness under fifo on a busy machine, {name}",
            "µs", with_policy, without, "ordinary policy",
        )  # fmt: skip


def may_be_punctual() -> bool:
    """Whether this user may have a real-time policy; tried in a process of its own."""
    code = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(40))"
    return subprocess.run([sys.executable, "-c", code], capture_output=True).returncode == 0


@contextmanager
def _busy_machine() -> Iterator[None]:
    """As many busy processes as there are processors."""
    busy = [
        subprocess.Popen([sys.executable, "-I", "-S", "-c", _BUSY])
        for _ in range(os.cpu_count() or 1)
    ]
    try:
        yield
    finally:
        for one in busy:
            one.kill()
            one.wait()
