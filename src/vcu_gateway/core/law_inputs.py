"""Inputs of the laws: the worst values since the tick before, and the front wheels' speed."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from vcu_gateway.core.state import LatestFrame, Snapshot
from vcu_gateway.core.tuning import WHEELS, WHEELS_SATURATED_KMH, Input

Span = tuple[float, float]


class InputReader:
    """Lowest and highest value of an input, read anew only where a frame of it came."""

    def __init__(self, one: Input) -> None:
        self._messages = one.messages
        self._kept: dict[str, tuple[LatestFrame, Span]] = {}

    def span(self, snapshot: Snapshot) -> Span | None:
        """None where one of its signals is not known."""
        lowest, highest = math.inf, -math.inf
        for message, signals in self._messages:
            if snapshot.stale(message):
                return None
            frames = snapshot.judged(message)
            kept = self._kept.get(message)
            if kept is None or len(frames) != 1 or frames[0] is not kept[0]:
                span = _span(snapshot, message, signals)
                if span is None:
                    return None
                kept = frames[-1], span
                if len(frames) == 1:
                    self._kept[message] = kept
            lowest, highest = min(lowest, kept[1][0]), max(highest, kept[1][1])
        return lowest, highest


def _span(snapshot: Snapshot, message: str, signals: Sequence[str]) -> Span | None:
    values: list[float] = []
    for signal in signals:
        good = snapshot.good_values(message, signal)
        if not good:
            return None
        values += good
    return min(values), max(values)


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
    message, wheels = WHEELS
    if snapshot.stale(message):
        return None
    indexes = [snapshot.index(message, wheel) for wheel in wheels]
    return min(_front(frame, indexes) for frame in snapshot.judged(message))


def _front(frame: LatestFrame, indexes: Sequence[int]) -> Front:
    decoded = frame.decoded
    if any(decoded.marks >> index & 1 for index in indexes):
        return Front(WHEELS_SATURATED_KMH, saturated=True)
    return Front(max(decoded.values[index] for index in indexes), saturated=False)
