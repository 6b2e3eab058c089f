"""Inputs of the laws: demand, the worst values since the tick before, the front wheels' speed."""

import math
from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.core.demand import ControllerDemands
from vcu_gateway.core.plausibility import SpeedsRpm
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import LatestFrame, Snapshot
from vcu_gateway.core.tuning import WHEELS, WHEELS_SATURATED_KMH, Input

RELEASED_PCT = 5.0
"""A demanded throttle below it is released."""


class LawInputs(NamedTuple):
    """What the laws know of a tick.

    Attributes:
        demanded: None without a fresh demand.
        active: the tick begins in ACTIVE.
        told: what limits is told: in STANDBY and ACTIVE.
        sent_throttle_pct: throttle of each controller's last command that left.
        motor_rpm: highest speed of each motor since the tick before; None where not believed.
        elapsed_s: since the tick before, at most a period.
    """

    snapshot: Snapshot
    settings: Settings
    demanded: ControllerDemands | None
    active: bool
    told: bool
    sent_throttle_pct: Mapping[str, float]
    motor_rpm: SpeedsRpm
    elapsed_s: float

    @property
    def released(self) -> bool:
        """Every controller's demanded throttle is below 5 %, or nothing is demanded."""
        demanded = self.demanded or {}
        return all(one.throttle_pct < RELEASED_PCT for one in demanded.values())


class InputReader:
    """Lowest and highest value of an input, read anew only where a frame of it came.

    Attributes:
        span: None where one of its signals is not known; the same object while nothing changes.
    """

    def __init__(self, one: Input) -> None:
        self._messages = one.messages
        self._frames: dict[str, LatestFrame] = {}
        self.span: tuple[float, float] | None = None

    def read(self, snapshot: Snapshot) -> bool:
        """Take in the frames of a tick; True where the span is another one."""
        if self.span is not None and self._unchanged(snapshot):
            return False
        span = self._read(snapshot)
        if span == self.span:
            return False
        self.span = span
        return True

    def _unchanged(self, snapshot: Snapshot) -> bool:
        for message, frame in self._frames.items():  # noqa: SIM110 - in every tick
            if not snapshot.judges_only(message, frame):
                return False
        return True

    def _read(self, snapshot: Snapshot) -> tuple[float, float] | None:
        lowest, highest = math.inf, -math.inf
        for message, signals in self._messages:
            for signal in signals:
                values = snapshot.good_values(message, signal)
                if not values:
                    return None
                lowest, highest = min(lowest, *values), max(highest, *values)
            self._frames[message] = snapshot.judged(message)[0]  # the latest, if it was alone
        return lowest, highest


class Front(NamedTuple):
    """Speed of the vehicle by its front wheels.

    Attributes:
        kmh: that of the faster wheel; of several frames since the tick before the lowest.
        saturated: a wheel is at the end of its signal, so that it may be any speed above.
    """

    kmh: float
    saturated: bool


def front_speed(snapshot: Snapshot) -> Front | None:
    """Speed by the front wheels; None where it is not known."""
    message, (left, right) = WHEELS
    if snapshot.stale(message):
        return None
    wheels = snapshot.index(message, left), snapshot.index(message, right)
    return min([_front(frame, *wheels) for frame in snapshot.judged(message)])


def _front(frame: LatestFrame, left: int, right: int) -> Front:
    marks, values = frame.decoded.marks, frame.decoded.values
    if marks >> left & 1 or marks >> right & 1:
        return Front(WHEELS_SATURATED_KMH, saturated=True)
    return Front(max(values[left], values[right]), saturated=False)
