"""Geometry of the vehicle measured from a drive: motor speed for each km/h.

Straight on, above 10 km/h and without a signal that cannot be relied upon; the median of all
samples, so that spinning wheels do not count.
"""

import statistics
from typing import NamedTuple

from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.state import Snapshot
from vcu_gateway.core.tuning import WHEELS

_SLOWEST_KMH, _FASTEST_KMH = 10.0, 65.0
_STRAIGHT_DEG = 5.0
_FEWEST = 40
_MOST = 100_000


class Geometry(NamedTuple):
    """Motor speed for each km/h, the median of so many samples."""

    motor_rpm_per_kmh: float
    samples: int


class GeometryMeasurement:
    """Takes a sample in each tick that has one."""

    def __init__(self) -> None:
        self._ratios: list[float] = []

    def tick(self, snapshot: Snapshot) -> None:
        message, wheels = WHEELS
        if len(self._ratios) >= _MOST or not snapshot.arrived(message):
            return
        steering_deg = snapshot.good_values(message, "SteeringAngle")
        speeds_kmh = [snapshot.good_values(message, wheel) for wheel in wheels]
        motors_rpm = [snapshot.good_values(f"{name}_Status2", "MotorSpeed") for name in CONTROLLERS]
        if not steering_deg or not all(speeds_kmh) or not all(motors_rpm):
            return
        front_kmh = statistics.fmean(one[-1] for one in speeds_kmh)
        if abs(steering_deg[-1]) <= _STRAIGHT_DEG and _SLOWEST_KMH <= front_kmh < _FASTEST_KMH:
            motor_rpm = statistics.fmean(one[-1] for one in motors_rpm)
            self._ratios.append(motor_rpm / front_kmh)

    def result(self) -> Geometry | None:
        """None with fewer than 40 samples."""
        if len(self._ratios) < _FEWEST:
            return None
        return Geometry(round(statistics.median(self._ratios), 1), len(self._ratios))
