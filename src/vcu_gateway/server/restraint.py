"""What is told once a second at most, so that nobody can fill the log from outside."""

from collections.abc import Hashable

_EVERY_NS = 1_000_000_000
_KINDS = 100


class LogRateLimit:
    """Lets one of a kind through in a second, and counts the others."""

    def __init__(self) -> None:
        self._told_ns: dict[Hashable, int] = {}
        self._untold: dict[Hashable, int] = {}

    def untold(self, kind: Hashable, now_ns: int) -> int | None:
        """How many of this kind were held back since the last one; None holds this one back."""
        if now_ns - self._told_ns.get(kind, now_ns - _EVERY_NS) < _EVERY_NS:
            self._untold[kind] = self._untold.get(kind, 0) + 1
            return None
        if kind not in self._told_ns and len(self._told_ns) >= _KINDS:
            oldest = min(self._told_ns, key=self._told_ns.__getitem__)
            del self._told_ns[oldest]
            self._untold.pop(oldest, None)
        self._told_ns[kind] = now_ns
        return self._untold.pop(kind, 0)
