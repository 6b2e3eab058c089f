"""Token buckets by key: of questions, of connections that give way, of attempts to sign in."""

from collections import OrderedDict

from vcu_gateway.units import NS_PER_S

_KEYS = 1024
_ATTEMPTS_OF_ADDRESS, _ATTEMPTS_OF_NAME = 5, 20
_ATTEMPT_S = 30.0


class CostLimit:
    """Token bucket for each key: `burst` tokens at once, then `per_s`; who comes too early waits.

    The keys that were used last are kept, 1024 of them.
    """

    def __init__(self, burst: int, per_s: float) -> None:
        self._token_ns = int(NS_PER_S / per_s)
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

    def forgive(self, key: str) -> None:
        """Give this key all of its tokens back."""
        self._free_ns.pop(key, None)


class LoginLimit:
    """Limits on failed attempts: 5 of an address, 20 of a name, then one every 30 s.

    A name has more, so that a stranger cannot keep somebody out who is at another address soon.
    """

    def __init__(self) -> None:
        self._addresses = CostLimit(_ATTEMPTS_OF_ADDRESS, 1 / _ATTEMPT_S)
        self._names = CostLimit(_ATTEMPTS_OF_NAME, 1 / _ATTEMPT_S)

    def wait_s(self, address: str, name: str, now_ns: int) -> int:
        """Seconds until an attempt is allowed, rounded up; 0 is now."""
        of_address = self._addresses.wait_ns(address, 1, now_ns)
        return -(-max(of_address, self._names.wait_ns(name, 1, now_ns)) // NS_PER_S)

    def failed(self, address: str, name: str, now_ns: int) -> None:
        self._addresses.take(address, 1, now_ns)
        self._names.take(name, 1, now_ns)

    def succeeded(self, address: str) -> None:
        self._addresses.forgive(address)
