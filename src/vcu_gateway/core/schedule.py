"""Time in the core: the grid of ticks, and when a frame arrived.

The kernel stamps frames on the wall clock only. Both clocks are slewed alike, so their
distance changes only when the wall clock is stepped (or the machine was suspended).

All integers, so that 200 days of uptime are as exact as the first second.
"""

import math
from bisect import bisect_left
from collections import deque
from collections.abc import Iterable
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
    """Monotonic arrival of a frame that was read at `now`, from its stamp of the wall clock.

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
    older_ns, newer_ns = min(possible), max(possible)
    # The older one, unless only the newer one lies after the last drain.
    return newer_ns if older_ns < before.monotonic_ns <= newer_ns else older_ns


def steady(before: ClockPair, now: ClockPair) -> bool:
    """True where the wall clock was not stepped between two readings.

    Then `stamp - now.distance_ns` is the arrival of every frame read at `now`.
    """
    return abs(now.distance_ns - before.distance_ns) <= _READING_ERROR_NS


_RECENT_TICKS = 1200

LATENESS_BOUNDS_NS = tuple(
    microseconds * 1_000
    for microseconds in (50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 25_000)
)
"""Upper bounds of the lateness histogram's bins; the last bin is open."""


@dataclass(frozen=True, slots=True)
class Tick:
    """One point of the grid that is due.

    Attributes:
        index: number of the grid point since the origin.
        deadline_ns: when it should have been; lateness_ns: how long ago that was.
        skipped: grid points missed immediately before this one.
    """

    index: int
    deadline_ns: int
    lateness_ns: int
    skipped: int


class Schedule:
    """The grid origin_ns + n * period_ns, walked without bursts: what was missed is skipped.

    A tick more than half a period late is skipped too: its frame would come closer than
    half a period to the next one. So is one that comes less than half a period after the
    frames before it really left (`left`): the machine may stall between deciding and sending.

    Attributes:
        lateness_counts: all ticks by LATENESS_BOUNDS_NS; recent_lateness_ns: the latest 1200.
    """

    def __init__(self, origin_ns: int, period_ns: int) -> None:
        if period_ns <= 0:
            raise ValueError(f"period_ns must be above 0, not {period_ns}")
        self.origin_ns = origin_ns
        self.period_ns = period_ns
        self.next_index = 0
        self.next_deadline_ns = origin_ns
        self.ticks = 0
        self.skipped = 0
        self.lateness_counts = [0] * (len(LATENESS_BOUNDS_NS) + 1)
        self.recent_lateness_ns: deque[int] = deque(maxlen=_RECENT_TICKS)
        self._pending_skips = 0
        self._earliest_ns = origin_ns

    def due(self, now_ns: int) -> Tick | None:
        """The tick to do now, or None; a missed one is counted and passed over."""
        late_ns = now_ns - self.next_deadline_ns
        if late_ns < 0:
            return None
        self._skip((late_ns + self.period_ns // 2) // self.period_ns)
        if now_ns < self.next_deadline_ns:
            return None
        if now_ns < self._earliest_ns:
            self._skip(1)
            return None
        return self._take(now_ns)

    def too_late(self, tick: Tick, now_ns: int) -> bool:
        """True where what was decided in this tick is too old to be sent now."""
        return now_ns - tick.deadline_ns >= self.period_ns // 2

    def left(self, now_ns: int) -> None:
        """The frames of the tick have left by now; the next ones keep their distance."""
        self._earliest_ns = now_ns + self.period_ns // 2

    def _skip(self, points: int) -> None:
        self.next_index += points
        self.next_deadline_ns += points * self.period_ns
        self.skipped += points
        self._pending_skips += points

    def _take(self, now_ns: int) -> Tick:
        deadline_ns = self.next_deadline_ns
        tick = Tick(self.next_index, deadline_ns, now_ns - deadline_ns, self._pending_skips)
        self.next_index += 1
        self.next_deadline_ns += self.period_ns
        self.ticks += 1
        self._pending_skips = 0
        self.lateness_counts[lateness_bin(tick.lateness_ns)] += 1
        self.recent_lateness_ns.append(tick.lateness_ns)
        return tick


def lateness_bin(lateness_ns: int) -> int:
    """Index of the histogram's bin for this lateness."""
    return bisect_left(LATENESS_BOUNDS_NS, lateness_ns)


def lateness_at(counts: list[int], share: float) -> int | None:
    """Upper bound, ns, of the bin that holds this share (0..1) of all ticks.

    None where nothing was counted or the share lies in the open bin.
    """
    total = sum(counts)
    reached = 0
    for bound_ns, count in zip(LATENESS_BOUNDS_NS, counts, strict=False):
        reached += count
        if total and reached >= share * total:
            return bound_ns
    return None


def percentile_ns(values_ns: Iterable[int], share: float) -> int | None:
    """The smallest value that this share (0..1) of all does not exceed; None without values."""
    ordered = sorted(values_ns)
    if not ordered:
        return None
    return ordered[max(0, math.ceil(share * len(ordered)) - 1)]
