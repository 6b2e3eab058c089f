"""When a subscription's next update is due, and what its reader missed."""

_NS_PER_S = 1_000_000_000


class SubscriptionState:
    """Updates on the grid origin_ns + n * period; the first at once.

    Attributes:
        messages: names to send; None for all.
        due_ns: when the next update is due.
        lost: updates that the reader missed since the last one, being slow.
    """

    def __init__(
        self, number: int, messages: list[str] | None, rate_hz: float, now_ns: int
    ) -> None:
        self.number = number
        self.messages = messages
        self.rate_hz = rate_hz
        self.due_ns = now_ns
        self.lost = 0
        self._period_ns = round(_NS_PER_S / rate_hz)

    def pass_by(self, now_ns: int) -> int:
        """Go on to the next point of the grid; how many points that leaves behind."""
        points = (now_ns - self.due_ns) // self._period_ns + 1
        self.due_ns += points * self._period_ns
        return points
