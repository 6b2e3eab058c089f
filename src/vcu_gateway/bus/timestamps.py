"""Pairs of wall-clock and monotonic time, read at one instant."""

import time

from vcu_gateway.core.schedule import ClockPair

_CLOSE_ENOUGH_NS = 50_000
_TRIES = 3


def read_clocks() -> ClockPair:
    """Read the wall clock between two readings of the monotonic one.

    A reading torn apart by the scheduler is taken again; the closest of three counts.
    """
    readings = []
    for _ in range(_TRIES):
        first_ns, wall_ns, last_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if last_ns - first_ns <= _CLOSE_ENOUGH_NS:
            return ClockPair(first_ns, wall_ns)
        readings.append((last_ns - first_ns, ClockPair(first_ns, wall_ns)))
    return min(readings, key=lambda reading: reading[0])[1]
