"""Token bucket for each of many keys."""

from collections import OrderedDict

from vcu_gateway.units import NS_PER_S

_KEYS = 1024


class CostLimit:
    """Token bucket for each key: `burst` at once, then `per_s`; who comes too early waits.

    The keys that were used last are kept, 1024 of them.
    """

    def __init__(self, burst: int, per_s: int) -> None:
        self._token_ns = NS_PER_S // per_s
        self._burst_ns = burst * self._token_ns
        self._free_ns: OrderedDict[str, int] = OrderedDict()

    def wait_ns(self, key: str, cost: int, now_ns: int) -> int:
        """Time until so much may be taken; 0 is now."""
        debt_ns = max(0, self._free_ns.get(key, 0) - now_ns)
        return max(0, debt_ns + cost * self._token_ns - self._burst_ns)

    def take(self, key: str, cost: int, now_ns: int) -> None:
        """Take it, from now or from after the wait."""
        self._free_ns[key] = max(self._free_ns.get(key, 0), now_ns) + cost * self._token_ns
        self._free_ns.move_to_end(key)
        if len(self._free_ns) > _KEYS:
            self._free_ns.popitem(last=False)
