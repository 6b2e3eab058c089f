"""Motor speeds, as far as they are known, and the interlock of regeneration."""

from typing import NamedTuple

from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.plausibility import Observed
from vcu_gateway.core.snapshot import Snapshot

SpeedsRpm = tuple[float | None, ...]


class MotorSpeeds(NamedTuple):
    """Lowest and highest speed of each motor in the frames since the tick before.

    None where one of them is out of range or follows a step that no motor makes, or the last
    one is stale.
    """

    lowest_rpm: SpeedsRpm
    highest_rpm: SpeedsRpm


_MESSAGES = {name: f"{name}_Status2" for name in CONTROLLERS}

UNKNOWN = MotorSpeeds(*[(None,) * len(CONTROLLERS)] * 2)


def of(snapshot: Snapshot, observed: Observed) -> MotorSpeeds:
    lowest: list[float | None] = []
    highest: list[float | None] = []
    for name, message in _MESSAGES.items():
        doubted = name in observed.speed_steps_rpm
        values = () if doubted else snapshot.good_values(message, "MotorSpeed")
        lowest.append(min(values) if values else None)
        highest.append(max(values) if values else None)
    return MotorSpeeds(tuple(lowest), tuple(highest))


def all_below(speeds_rpm: SpeedsRpm, limit_rpm: float) -> bool:
    for speed in speeds_rpm:  # noqa: SIM110 - in every tick; a generator takes twice the time
        if speed is None or speed >= limit_rpm:
            return False
    return True


def all_at_least(speeds_rpm: SpeedsRpm, limit_rpm: float) -> bool:
    for speed in speeds_rpm:  # noqa: SIM110 - in every tick; a generator takes twice the time
        if speed is None or speed < limit_rpm:
            return False
    return True


_RETURN_RPM = 50.0


class RegenerationInterlock:
    """Interlock of regeneration: both motors turn fast enough, with a hysteresis of 50 rpm."""

    def __init__(self) -> None:
        self._possible = False

    def possible(self, speeds_rpm: SpeedsRpm, min_rpm: float) -> bool:
        """Judge the speeds of a tick, None where one is not known; `min_rpm` 0: always.

        Once both are known and 50 rpm above `min_rpm` it is possible, until one is not known
        or below `min_rpm`.
        """
        least_rpm = min_rpm if self._possible else min_rpm + _RETURN_RPM
        self._possible = min_rpm == 0 or all_at_least(speeds_rpm, least_rpm)
        return self._possible
