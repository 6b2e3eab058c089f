"""What an owner sends and when: the dead-man on the client's side. No clock, no socket."""

from collections.abc import Mapping
from typing import Any

from vcu_gateway.api import results
from vcu_gateway.client.demand import NO_MOTION, RequestValues, without_motion
from vcu_gateway.client.errors import ApiError

_NS_PER_MS = 1_000_000
_NS_PER_US = 1_000
_NS_PER_S = 1_000_000_000
_SHORTEST_PAUSE_NS = 1_000_000
_LONGEST_PAUSE_NS = 1_000_000_000
_DIRECTIONS_DIFFER = "directions_differ"

Demand = Mapping[str, Any]
"""The parameters of one `demand.set`."""

RELEASED_S = 0.2
"""How long the gateway must have been asked for no throttle before it can be armed."""


class DeadMan:
    """Numbers demands, repeats the last one, and lets it end.

    Asked-for values are repeated every third of their time to live, until `hold_s` after they
    were asked for; from then on no throttle and no brake is. The same follows a refusal and a
    new connection, until values are asked for again.

    Attributes:
        refusal: the error that `ask` raises next or raised last; None again once a later
            demand is granted.
        last_answer: what the gateway granted last; None before.
        due_ns: when `repeat` is due.
    """

    def __init__(self, source: str, ttl_ms: int, hold_s: float | None) -> None:
        self.source = source
        self.refusal: ApiError | None = None
        self.last_answer: results.Granted | None = None
        self.due_ns = 0
        self._ttl_ms = ttl_ms
        self._hold_ns = None if hold_s is None else round(hold_s * _NS_PER_S)
        self._body: RequestValues = NO_MOTION
        self._hold_end_ns: int | None = None
        self._told = True
        self._sequence = 0
        self._refused_in_a_row = 0

    def ask(self, body: RequestValues, now_ns: int) -> Demand:
        """New values; instead raises a refusal that nobody has been told."""
        if self.refusal is not None and not self._told:
            self._told = True
            raise self.refusal
        self._body = body
        self._hold_end_ns = None if self._hold_ns is None else now_ns + self._hold_ns
        return self._demand(now_ns)

    def repeat(self, now_ns: int) -> Demand:
        """The last values once more, vouched for now, or no motion where their hold has ended."""
        if self._hold_end_ns is not None and now_ns >= self._hold_end_ns:
            self.still()
        return self._demand(now_ns)

    def still(self) -> None:
        """Ask for no motion from the next demand on."""
        self._body = without_motion(self._body)
        self._hold_end_ns = None

    def next_number(self, now_ns: int) -> int:
        """Rising, also above the numbers of a process before this one on the same machine."""
        self._sequence = max(self._sequence + 1, now_ns // _NS_PER_US)
        return self._sequence

    def granted(self, answer: results.Granted) -> None:
        """The gateway took a demand."""
        self.last_answer = answer
        self._refused_in_a_row = 0
        if self._told:
            self.refusal = None

    def refused(self, error: ApiError) -> None:
        """The gateway refused a demand: no motion is asked for, the first time at once."""
        self.refusal, self._told = error, False
        self._refused_in_a_row += 1
        self.still()
        if error.refusal == _DIRECTIONS_DIFFER:
            self._body = NO_MOTION
        if self._refused_in_a_row == 1:
            self.due_ns = 0

    def _demand(self, now_ns: int) -> Demand:
        self.due_ns = now_ns + self._pause_ns()
        if self._hold_end_ns is not None:
            self.due_ns = min(self.due_ns, self._hold_end_ns)
        return {
            "source": self.source,
            "sequence": self.next_number(now_ns),
            "ttl_ms": self._ttl_ms,
            "made_ns": now_ns,
            **self._body,
        }

    def _pause_ns(self) -> int:
        """A third of the time to live; longer from refusal to refusal, up to a second."""
        pause_ns = max(self._ttl_ms * _NS_PER_MS // 3, _SHORTEST_PAUSE_NS)
        return min(pause_ns << min(self._refused_in_a_row, 10), max(pause_ns, _LONGEST_PAUSE_NS))
