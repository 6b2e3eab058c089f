"""Arrival time: the kernel's stamps of the wall clock in monotonic time.

The kernel stamps frames on the wall clock only. Both clocks are slewed alike, so their
distance changes only when the wall clock is stepped (or the machine was suspended).
"""

from dataclasses import dataclass

# Two readings of both clocks differ by this much without any step.
_READING_ERROR_NS = 1_000_000


@dataclass(frozen=True, slots=True)
class ClockPair:
    """Both clocks, read at the same instant, in nanoseconds."""

    monotonic_ns: int
    wall_ns: int

    @property
    def distance_ns(self) -> int:
        """Wall minus monotonic."""
        return self.wall_ns - self.monotonic_ns


def arrival_ns(stamp_wall_ns: int, before: ClockPair, now: ClockPair) -> int:
    """Monotonic arrival of a frame that was read at `now`.

    `before` is the reading of the drain before: whatever is read now arrived after it or
    was left over from it. Where the wall clock was stepped between the two, it is not known
    whether a stamp was taken before or after the step; the reading that is possible (not in
    the future) and older wins, because a frame must never look fresher than it is. A stamp
    that no reading makes possible counts as arriving at `before`.
    """
    by_now = stamp_wall_ns - now.distance_ns
    by_before = stamp_wall_ns - before.distance_ns
    possible = [at for at in (by_now, by_before) if at <= now.monotonic_ns]
    if not possible:
        return before.monotonic_ns
    if len(possible) == 1:
        return possible[0]
    return _likelier(min(possible), max(possible), before.monotonic_ns)


def steady(before: ClockPair, now: ClockPair) -> bool:
    """True where the wall clock was not stepped between two readings.

    Then `stamp - now.distance_ns` is the arrival of every frame read at `now`.
    """
    return abs(now.distance_ns - before.distance_ns) <= _READING_ERROR_NS


def _likelier(older_ns: int, newer_ns: int, earliest_ns: int) -> int:
    """Older of two readings, unless only the newer one lies after the last drain."""
    return newer_ns if older_ns < earliest_ns <= newer_ns else older_ns
