"""What a test looks at for a while."""

import time

from tests.oracle import wire
from tests.oracle.bench import GRACE_S, Bench

TICK_S, JITTER_S = 0.050, 0.010


def of_pcu1(frames: list) -> list:
    return [f for f in frames if f.can_id == wire.PCU1_COMMAND]


def on_ramp(before: float, after: float, target: float, per_s: float, gap_s: float) -> bool:
    """One tick along a ramp: its period at most, and no less than the time that passed."""
    ahead = 1 if target >= before else -1
    step = ahead * (after - before)
    if after == target:
        return step <= per_s * TICK_S * 1.001 + 1
    least = per_s * (min(gap_s, TICK_S) - JITTER_S) - 1
    return ahead * (target - after) > 0 and least <= step <= per_s * TICK_S + 1


def settled(bench: Bench, values: dict) -> wire.Command:
    """The command two ticks after a demand."""
    bench.demand(**values)
    return bench.ticks(time.monotonic() + GRACE_S, 2)[-1].command


def throttles_stay_zero(bench: Bench, for_s: float) -> bool:
    since = time.monotonic()
    bench.rest(for_s)
    frames = bench.commands(since + GRACE_S + TICK_S)
    return bool(frames) and all(f.command.throttle == 0 for f in frames)


def rises(bench: Bench, patience_s: float = 0.4) -> bool:
    since = time.monotonic()
    bench.rest(patience_s)
    return any(f.command.throttle for f in bench.commands(since))
