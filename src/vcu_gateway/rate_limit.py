"""Rate limits: a token bucket, and at most one log line of a kind per second."""

from collections.abc import Hashable

from vcu_gateway.units import NS_PER_S

_MAX_KINDS = 100


class TokenBucket:
    """Token bucket: one in `interval_ns`, bursts of `burst`; integers only.

    `take` is allowed from `ready_ns` on, in nanoseconds of the caller's clock.
    """

    def __init__(self, interval_ns: int, burst: int, now_ns: int) -> None:
        self._interval_ns = interval_ns
        self._burst_ns = burst * self._interval_ns
        self._taken_until_ns = now_ns - self._burst_ns

    @property
    def ready_ns(self) -> int:
        """Earliest time of the next `take`."""
        return self._taken_until_ns + self._interval_ns

    def take(self, now_ns: int) -> None:
        """Only from `ready_ns` on."""
        self._taken_until_ns = max(self.ready_ns, now_ns - self._burst_ns + self._interval_ns)

    def taken(self, now_ns: int) -> bool:
        """Take one; False where it is too early."""
        if now_ns < self.ready_ns:
            return False
        self.take(now_ns)
        return True


class LogRateLimit:
    """Log rate limit: admits one of a kind per second and counts the others; at most 100 kinds."""

    def __init__(self) -> None:
        self._admitted_ns: dict[Hashable, int] = {}
        self._suppressed: dict[Hashable, int] = {}

    def admit(self, kind: Hashable, now_ns: int) -> int | None:
        """Number suppressed since the last one admitted; None where this one is suppressed."""
        if now_ns - self._admitted_ns.get(kind, now_ns - NS_PER_S) < NS_PER_S:
            self._suppressed[kind] = self._suppressed.get(kind, 0) + 1
            return None
        if kind not in self._admitted_ns and len(self._admitted_ns) >= _MAX_KINDS:
            oldest = min(self._admitted_ns, key=self._admitted_ns.__getitem__)
            del self._admitted_ns[oldest]
            self._suppressed.pop(oldest, None)
        self._admitted_ns[kind] = now_ns
        return self._suppressed.pop(kind, 0)
