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
        return self._taken_until_ns + self._interval_ns

    def take(self, now_ns: int) -> None:
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
        self._kinds: dict[Hashable, tuple[int, int]] = {}
        """When one was admitted last, and how many were suppressed since."""

    def admit(self, kind: Hashable, now_ns: int) -> int | None:
        """Number suppressed since the last one admitted; None where this one is suppressed."""
        admitted_ns, suppressed = self._kinds.pop(kind, (now_ns - NS_PER_S, 0))
        if now_ns - admitted_ns < NS_PER_S:
            self._kinds[kind] = admitted_ns, suppressed + 1
            return None
        if len(self._kinds) >= _MAX_KINDS:
            del self._kinds[min(self._kinds, key=self._kinds.__getitem__)]
        self._kinds[kind] = now_ns, 0
        return suppressed
