"""Whether the receiving thread lives, seen from the ticking thread."""

from vcu_gateway.bus.connection import BusConnection

# The reader wakes at least every 120 ms, which is seen at every third tick. Ticks are counted
# and not time: a process that stood still has a reader that stood still too.
_TICKS_IN_DOUBT = 10
_TICKS_TO_DEATH = 20


class ReceiverWatchdog:
    """Looks after each tick whether the reader has woken since.

    Attributes:
        alive: False while it is in doubt.
    """

    def __init__(self, door: BusConnection) -> None:
        self._door = door
        self._wakes: int | None = None
        self._still_ticks = 0

    def observe(self) -> None:
        """After each tick; RuntimeError where the reader has not woken for 20 of them."""
        before, self._wakes = self._wakes, self._door.reader_wakes
        still = self._wakes is not None and self._wakes == before
        self._still_ticks = self._still_ticks + 1 if still else 0
        if self._still_ticks >= _TICKS_TO_DEATH:
            raise RuntimeError("the receiving thread is dead or stuck; nothing is heard any more")

    @property
    def alive(self) -> bool:
        """True while nothing speaks against it."""
        return self._still_ticks < _TICKS_IN_DOUBT
