"""Gaps between the ticks in which the API's thread may work, so that it makes no tick late.

Threads of one interpreter share its lock: a thread that computes while a tick is due delays
the tick. So the API works between the ticks, and only for a share of the time.
"""

import time
from collections.abc import Callable
from typing import NamedTuple, Protocol

from vcu_gateway.units import NS_PER_S

UNIT_NS = 1_000_000
"""Default cost of one unit of work."""


class GapShare(NamedTuple):
    """Division of a tick period.

    Attributes:
        before_ns: no work begins in this time before a deadline.
        after_ns: nor in this time after a tick was taken: it sends and logs.
        share: part of a period, 0 to 1, that may be worked in.
        check_ns: interval of the checks for an overdue tick.
    """

    before_ns: int = 2_500_000
    after_ns: int = 1_000_000
    share: float = 0.4
    check_ns: int = 1_000_000


DEFAULT_SHARE = GapShare()


class TickGrid(Protocol):
    """Ticks to come; `next_deadline_ns` moves on when one is taken."""

    period_ns: int
    next_deadline_ns: int


class Ticking(Protocol):
    """The ticking thread's loop: it begins a new grid with its first tick."""

    @property
    def schedule(self) -> TickGrid: ...


class TickGaps:
    """Gate that one thread passes before each unit of work; see `wait`."""

    def __init__(
        self,
        loop: Ticking,
        gap: GapShare = DEFAULT_SHARE,
        now_ns: Callable[[], int] = time.monotonic_ns,
        worked_ns: Callable[[], int] = time.thread_time_ns,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """`worked_ns` is the thread's processor time; `sleep` takes seconds.

        Everything else counts in nanoseconds of `now_ns`.
        """
        self._loop = loop
        self._period_ns = period_ns = loop.schedule.period_ns
        self._gap = gap
        self._share_ns = int(period_ns * gap.share)
        self._now_ns, self._worked_ns, self._sleep = now_ns, worked_ns, sleep
        self._deadline_ns = loop.schedule.next_deadline_ns
        self._updated_ns = now_ns()
        self._open_ns = self._updated_ns
        # Begun at the first update: that is on the thread whose time counts.
        self._share_from_ns = self._updated_ns - period_ns
        self._worked_before_ns = 0

    def wait(self, cost_ns: int = UNIT_NS) -> None:
        """Sleep until work of this cost fits into the gap; return at once where it does.

        Sleeps for little more than a period where no tick is taken.
        """
        cost_ns = min(cost_ns, self._share_ns // 2)
        while True:
            now_ns = self._now_ns()
            until_ns = self._open_at(now_ns, cost_ns)
            if until_ns <= now_ns:
                return
            self._sleep((until_ns - now_ns) / NS_PER_S)

    def _open_at(self, now_ns: int, cost_ns: int) -> int:
        """Time of the next check; `now_ns` or before where the work may begin now."""
        self._update(now_ns)
        overdue_ns = now_ns - self._deadline_ns
        if overdue_ns >= self._period_ns:  # not started, or stuck: there is no tick to delay
            return self._share_open_at(now_ns, cost_ns)
        if now_ns < self._open_ns:
            return self._open_ns
        if overdue_ns >= self._gap.after_ns:
            return now_ns + self._gap.check_ns
        if -overdue_ns < max(self._gap.before_ns, cost_ns):
            return self._deadline_ns + self._gap.after_ns
        share_open_ns = self._share_open_at(now_ns, cost_ns)
        return min(share_open_ns, self._deadline_ns + self._gap.after_ns)

    def _update(self, now_ns: int) -> None:
        """Note a tick that was taken, and begin a new share then or after a period without one."""
        deadline_ns = self._loop.schedule.next_deadline_ns
        if deadline_ns != self._deadline_ns:
            was_late = self._updated_ns >= self._deadline_ns
            taken_ns = now_ns if was_late else deadline_ns - self._period_ns
            self._open_ns = min(taken_ns, now_ns) + self._gap.after_ns
            self._deadline_ns = deadline_ns
            self._begin_share(now_ns)
        elif now_ns - self._share_from_ns >= self._period_ns:
            self._begin_share(now_ns)
        self._updated_ns = now_ns

    def _begin_share(self, now_ns: int) -> None:
        self._share_from_ns = now_ns
        self._worked_before_ns = self._worked_ns()

    def _share_open_at(self, now_ns: int, cost_ns: int) -> int:
        worked_ns = self._worked_ns() - self._worked_before_ns
        if worked_ns + cost_ns <= self._share_ns:
            return now_ns
        return self._share_from_ns + self._period_ns
