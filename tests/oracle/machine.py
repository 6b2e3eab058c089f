"""Whether the machine itself is to blame."""

import time


class MachineSpeed:
    """Whether others take this machine's processor away: a busy one is slow, not still."""

    def __init__(self) -> None:
        self._best_s = min(self._loop() for _ in range(5))

    def is_slow(self) -> bool:
        took = sorted(self._loop() for _ in range(5))
        self._best_s = min(self._best_s, took[0])
        return took[2] > 1.4 * self._best_s or took[4] > 3 * self._best_s

    def wait_for_quiet(self, patience_s: float = 5.0) -> None:
        deadline = time.monotonic() + patience_s
        while self.is_slow() and time.monotonic() < deadline:
            time.sleep(0.5)

    @staticmethod
    def _loop() -> float:
        began = time.monotonic()
        sum(range(200_000))
        return time.monotonic() - began
