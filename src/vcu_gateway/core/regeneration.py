"""Regeneration by speed: at a standstill, and rolling slowly, it brakes nothing and may push."""

from vcu_gateway.core.motor_speeds import SpeedsRpm, all_at_least

_RETURN_RPM = 50.0


class RegenerationInterlock:
    """Whether the motors turn fast enough to recover energy; with hysteresis."""

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
