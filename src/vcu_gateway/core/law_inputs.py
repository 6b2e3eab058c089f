"""Inputs of the laws: demand, the worst values since the tick before, the front wheels' speed."""

from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.core.commands import Command
from vcu_gateway.core.demand import RELEASED_PCT, ControllerDemands
from vcu_gateway.core.plausibility import SpeedsRpm
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import LatestFrame, Snapshot
from vcu_gateway.core.tuning import WHEELS, WHEELS_SATURATED_KMH, Input


class LawInputs(NamedTuple):
    """What the laws know of a tick.

    Attributes:
        demanded: None without a fresh demand.
        active: the tick begins in ACTIVE.
        told: what limits is told: in STANDBY and ACTIVE.
        last: each controller's last command that left.
        motor_rpm: highest speed of each motor since the tick before; None where not believed.
        elapsed_s: since the tick before, at most a period.
    """

    snapshot: Snapshot
    settings: Settings
    demanded: ControllerDemands | None
    active: bool
    told: bool
    last: Mapping[str, Command]
    motor_rpm: SpeedsRpm
    elapsed_s: float

    @property
    def released(self) -> bool:
        """Every controller's demanded throttle is below 5 %, or nothing is demanded."""
        demanded = self.demanded or {}
        return all(one.throttle_pct < RELEASED_PCT for one in demanded.values())


class InputReader:
    """Lowest and highest value of an input; to be read where one of its messages changed.

    Attributes:
        messages: names of its messages.
        span: None where one of its signals is not known; the same object while nothing changes.
    """

    def __init__(self, one: Input, snapshot: Snapshot) -> None:
        self._places: list[tuple[str, int, list[int]]] = []  # with the marks of all its signals
        for message, signals in one.messages:
            all_indexes = snapshot.indexes(message)
            indexes = [all_indexes[signal] for signal in signals]
            self._places.append((message, sum([1 << index for index in indexes]), indexes))
        self.messages = [message for message, _ in one.messages]
        self.span: tuple[float, float] | None = None

    def read(self, snapshot: Snapshot) -> bool:
        """Take in the frames of a tick; True where the span is another one."""
        span = self._read(snapshot)
        if span == self.span:
            return False
        self.span = span
        return True

    def _read(self, snapshot: Snapshot) -> tuple[float, float] | None:
        found: list[float] = []
        for message, marks, indexes in self._places:
            frames = snapshot.fresh(message)
            if not frames:
                return None
            for frame in frames:
                decoded = frame.decoded
                if decoded.marks & marks:
                    return None
                values = decoded.values
                for index in indexes:
                    found.append(values[index])  # noqa: PERF401 - mostly one; extend is a call more
        return min(found), max(found)


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
    frames = snapshot.fresh(message)
    if not frames:
        return None
    indexes = snapshot.indexes(message)
    wheels = indexes[left], indexes[right]
    if len(frames) == 1:  # in most ticks
        return _front(frames[0], *wheels)
    return min([_front(frame, *wheels) for frame in frames])


def _front(frame: LatestFrame, left: int, right: int) -> Front:
    decoded = frame.decoded
    if decoded.marks & (1 << left | 1 << right):
        return Front(WHEELS_SATURATED_KMH, saturated=True)
    values = decoded.values
    return Front(max(values[left], values[right]), saturated=False)
