"""Reference ticks: what the machine does to a process that only ticks every 50 ms, the bystander.

The process has a second thread that computes for some milliseconds at a time, as one that reads
frames does: it is no busier than the gateway, and knows nothing of it.
"""

import json
import sys
import threading
import time
from pathlib import Path

PERIOD_NS = 50_000_000
READ_EVERY_S = 0.017


def run(path: Path, duration_s: float, busy_s: float) -> None:
    """Sleep to each point of the grid; how late each time, ns, in the file at the end."""
    sys.setswitchinterval(0.0005)
    threading.Thread(target=_read, args=(busy_s,), daemon=True).start()
    late_ns = []
    begun_ns = time.monotonic_ns()
    due_ns = begun_ns
    while due_ns < begun_ns + duration_s * 1e9:
        time.sleep(max(0, due_ns - time.monotonic_ns()) / 1e9)
        late_ns.append(time.monotonic_ns() - due_ns)
        due_ns += PERIOD_NS * (1 + (late_ns[-1] + PERIOD_NS // 2) // PERIOD_NS)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(late_ns))
    part.rename(path)


def _read(busy_s: float) -> None:
    while True:
        end_s = time.monotonic() + busy_s
        while time.monotonic() < end_s:
            pass
        time.sleep(READ_EVERY_S)


def skipped(path: Path) -> int:
    """Points that a scheduler with the gateway's rule would have missed."""
    return sum((late + PERIOD_NS // 2) // PERIOD_NS for late in json.loads(path.read_text()))
