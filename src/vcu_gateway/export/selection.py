"""Selection of signals: `--signals GLOB`."""

from collections.abc import Iterable
from fnmatch import fnmatchcase


class Selection:
    """Signals that some patterns ask for; every one where there are no patterns.

    A pattern is compared with `Message.Signal`, with the message and with the signal alone,
    whatever the case.
    """

    def __init__(self, patterns: Iterable[str] = ()) -> None:
        self._patterns = {pattern: pattern.lower() for pattern in patterns}
        self._unused = set(self._patterns)

    def wants(self, table: str, signal: str) -> bool:
        if not self._patterns:
            return True
        names = (f"{table}.{signal}".lower(), table.lower(), signal.lower())
        found = False
        for pattern, lowered in self._patterns.items():
            if any(fnmatchcase(name, lowered) for name in names):
                self._unused.discard(pattern)
                found = True
        return found

    @property
    def unused(self) -> tuple[str, ...]:
        """Patterns that no signal answered to so far."""
        return tuple(sorted(self._unused))
