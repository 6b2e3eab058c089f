"""Limit on attempts to sign in, for each address and for each name."""

from collections import OrderedDict

from vcu_gateway.units import NS_PER_S

_KEYS = 1024
_PER_ADDRESS, _PER_NAME = 5, 20
_REFILL_NS = 30 * NS_PER_S


class AttemptLimit:
    """Token bucket for each key: `burst` attempts at once, then one every 30 s.

    The keys that were used last are kept, 1024 of them.
    """

    def __init__(self, burst: int) -> None:
        self._burst_ns = burst * _REFILL_NS
        self._free_ns: OrderedDict[str, int] = OrderedDict()

    def wait_ns(self, key: str, now_ns: int) -> int:
        """Time until the next attempt is allowed; 0 is now."""
        debt_ns = max(0, self._free_ns.get(key, 0) - now_ns)
        return max(0, debt_ns + _REFILL_NS - self._burst_ns)

    def count(self, key: str, now_ns: int) -> None:
        """Count a failed attempt."""
        self._free_ns[key] = max(self._free_ns.get(key, 0), now_ns) + _REFILL_NS
        self._free_ns.move_to_end(key)
        if len(self._free_ns) > _KEYS:
            self._free_ns.popitem(last=False)

    def forgive(self, key: str) -> None:
        """Forget the failures of whoever knew the password in the end."""
        self._free_ns.pop(key, None)


class LoginLimit:
    """Limits on failed attempts: 5 of an address, 20 of a name, then one every 30 s.

    A name has more, so that a stranger cannot keep somebody out who is at another address soon.
    """

    def __init__(self) -> None:
        self._addresses = AttemptLimit(_PER_ADDRESS)
        self._names = AttemptLimit(_PER_NAME)

    def wait_s(self, address: str, name: str, now_ns: int) -> int:
        """Seconds until an attempt is allowed, rounded up; 0 is now."""
        wait_ns = max(self._addresses.wait_ns(address, now_ns), self._names.wait_ns(name, now_ns))
        return -(-wait_ns // NS_PER_S)

    def failed(self, address: str, name: str, now_ns: int) -> None:
        """Count a failure."""
        self._addresses.count(address, now_ns)
        self._names.count(name, now_ns)

    def succeeded(self, address: str) -> None:
        """Forget the failures of this address."""
        self._addresses.forgive(address)
