"""Drain plan: when the ticking thread reads the bus."""

from vcu_gateway.units import NS_PER_MS

# Half of what the kernel's usual receive buffer holds.
_BUSY_FRAMES = 139
_LEAD_MAX_NS = 4 * NS_PER_MS
# A stall moves the lead by an eighth of this.
_LONGER_MAX_NS = 400_000


class DrainPlan:
    """Everything is read shortly before each tick, and in mid-period while the bus is busy.

    Attributes:
        lead_ns: time that waking up and reading before a tick usually take; the thread is to wake
            so much earlier.
        busy: in the last period more frames were read than half the usual receive buffer holds.
    """

    def __init__(self) -> None:
        self.lead_ns = 0
        self.busy = False
        self._frames = 0

    def read_between(self, frames: int) -> None:
        self._frames = frames

    def read_before_tick(self, frames: int, took_ns: int) -> None:
        """Note frames that were read before a tick, and the time since the thread was to wake."""
        self.busy = self._frames + frames > _BUSY_FRAMES
        self._frames = 0
        longer_ns = min(took_ns, _LEAD_MAX_NS) - self.lead_ns
        self.lead_ns += min(longer_ns, _LONGER_MAX_NS) // 8
