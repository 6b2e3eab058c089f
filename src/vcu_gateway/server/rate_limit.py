"""So many a second, and some of them at once."""

from vcu_gateway.units import NS_PER_S


class TokenBucket:
    """A token bucket in integers: `take` only from `ready_ns` on."""

    def __init__(self, rate_per_s: int, burst: int, now_ns: int) -> None:
        self._interval_ns = NS_PER_S // rate_per_s
        self._burst_ns = burst * self._interval_ns
        self._taken_until_ns = now_ns - self._burst_ns

    @property
    def ready_ns(self) -> int:
        """From when on the next one may be taken."""
        return self._taken_until_ns + self._interval_ns

    def take(self, now_ns: int) -> None:
        """One is taken now."""
        self._taken_until_ns = max(self.ready_ns, now_ns - self._burst_ns + self._interval_ns)
