"""What a drive says of its tuning: where it was on each curve, and the vehicle's geometry.

    uses = CurveUses(before, after)          # settings
    uses.tick(snapshot, mode)                # every tick
    uses.result()

Both sides of a change are computed from the replayed inputs, with the law of the core.
"""

import statistics
from typing import NamedTuple

from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.deratings import Deratings
from vcu_gateway.core.law_inputs import LawInputs
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Snapshot
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.core.tuning import DERATINGS, WHEELS
from vcu_gateway.units import NS_PER_S

_LONGEST_STEP_NS = NS_PER_S
_SLOWEST_KMH, _FASTEST_KMH = 10.0, 65.0
_STRAIGHT_DEG = 5.0
_FEWEST = 40
_MOST = 100_000


class CurveSide(NamedTuple):
    """A curve on one side.

    Attributes:
        points: None where it is not configured there.
        limited_s: seconds with a limit below its highest point; lowest: the lowest limit.
    """

    points: tuple[tuple[float, float], ...] | None
    limited_s: float
    lowest: float | None


class CurveUse(NamedTuple):
    """A curve of a drive.

    Attributes:
        seconds_at: seconds at each value of the input, rounded to its step.
        unknown_s: seconds with an unknown input.
    """

    key: str
    seconds_at: tuple[tuple[float, float], ...]
    unknown_s: float
    before: CurveSide
    after: CurveSide

    @property
    def same(self) -> bool:
        return self.before == self.after


class _CurveSideCounts:
    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.curves = settings.tuning.curves
        self.limited_s = dict.fromkeys(self.curves, 0.0)
        self.lowest: dict[str, float] = {}
        self.deratings = Deratings()

    def tick(self, snapshot: Snapshot, active: bool, elapsed_s: float, step_s: float) -> None:
        inputs = LawInputs(snapshot, self.settings, None, active, False, {}, (), elapsed_s)
        self.deratings.tick(inputs, {})
        for name, curve in self.curves.items():
            cap = self.deratings.held[name]
            self.lowest[name] = min(cap, self.lowest.get(name, cap))
            self.limited_s[name] += step_s if cap < curve.highest else 0.0

    def of(self, name: str) -> CurveSide:
        curve = self.curves.get(name)
        if curve is None:
            return CurveSide(None, 0.0, None)
        return CurveSide(curve.points, round(self.limited_s[name], 3), self.lowest.get(name))


class CurveUses:
    """Counts both sides; nothing is done where neither has a curve."""

    def __init__(self, before: Settings, after: Settings) -> None:
        self._sides = _CurveSideCounts(before), _CurveSideCounts(after)
        self._names = tuple({**before.tuning.curves, **after.tuning.curves})
        self._seconds_at: dict[str, dict[float, float]] = {name: {} for name in self._names}
        self._unknown_s = dict.fromkeys(self._names, 0.0)
        self._last_ns: int | None = None

    def tick(self, snapshot: Snapshot, mode: Mode) -> None:
        """Take in a tick that began in this mode."""
        if not self._names:
            return
        since_ns = 0 if self._last_ns is None else snapshot.now_ns - self._last_ns
        self._last_ns = snapshot.now_ns
        step_s = min(max(since_ns, 0), _LONGEST_STEP_NS) / NS_PER_S
        for side in self._sides:
            period_s = side.settings.period_ns / NS_PER_S
            side.tick(snapshot, mode is Mode.ACTIVE, min(step_s, period_s), step_s)
        before, after = self._sides
        worst = {**before.deratings.worst, **after.deratings.worst}
        for name in self._names:
            x = worst[name]
            if x is None:
                self._unknown_s[name] += step_s
                continue
            step = DERATINGS[name].input.quantity.step
            place = round(round(x / step) * step, 3)
            at = self._seconds_at[name]
            at[place] = at.get(place, 0.0) + step_s

    def result(self) -> tuple[CurveUse, ...]:
        before, after = self._sides
        return tuple(
            CurveUse(
                DERATINGS[name].key,
                tuple((x, round(s, 3)) for x, s in sorted(self._seconds_at[name].items())),
                round(self._unknown_s[name], 3),
                before.of(name),
                after.of(name),
            )
            for name in self._names
        )


class Geometry(NamedTuple):
    """Motor speed for each km/h, the median of so many samples."""

    motor_rpm_per_kmh: float
    samples: int


class GeometryMeasurement:
    """Geometry from a drive: motor speed for each km/h.

    Straight on, above 10 km/h and without a signal that cannot be relied upon; the median of all
    samples, so that spinning wheels do not count.
    """

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
