"""Plausibility: frames held against the ones before them and against sent commands.

Every frame since the tick before is looked at once, in the order of arrival; one that is older
than the one before it is no next step of anything and is left out there. Its verdict
stands until the next one of its kind.

Motor speeds, as far as they are known, and the interlock of regeneration.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import LatestFrame, Snapshot
from vcu_gateway.core.transmit import SentValues
from vcu_gateway.units import NS_PER_MS

_STATUS1 = {name: f"{name}_Status1" for name in CONTROLLERS}
_STATUS2 = {name: f"{name}_Status2" for name in CONTROLLERS}

WHEELS_MESSAGE = "ARD2_SteeringWheel"
WHEELS = ("WheelSpeedFL", "WheelSpeedFR")

_THROTTLE_WINDOW_NS = 1_000 * NS_PER_MS
_DIRECTION_WINDOW_NS = 1_100 * NS_PER_MS
_STEP_WITHIN_NS = 100 * NS_PER_MS
_ABOVE_MAX_PCT = 5.0
_PLAUSIBLE_FRAMES = 3

History = Mapping[str, Sequence[SentValues]]


class ThrottleExcess(NamedTuple):
    """A throttle that was echoed, and the highest that was commanded before, in percent."""

    echoed_pct: float
    commanded_pct: float


@dataclass(frozen=True, slots=True)
class Observed:
    """Deviations that one tick found, by controller or by wheel.

    Attributes:
        echo_above: the highest throttle that was not commanded.
        echo_below: frames in a row that echoed too little throttle, at the most in this tick.
        echoes_below: the controllers whose last frame did.
        echo_direction: the same for a direction that was not commanded.
        speed_steps_rpm: the last implausible change, while the speed is not believed again.
        wheel_steps_kmh: implausible changes of this tick.
        wheels_apart_ns: for how long both wheels differ too much, or did in this tick; None
            where they do not.
    """

    echo_above: Mapping[str, ThrottleExcess] = field(default_factory=dict)
    echo_below: Mapping[str, int] = field(default_factory=dict)
    echoes_below: frozenset[str] = frozenset()
    echo_direction: Mapping[str, int] = field(default_factory=dict)
    speed_steps_rpm: Mapping[str, float] = field(default_factory=dict)
    wheel_steps_kmh: Mapping[str, float] = field(default_factory=dict)
    wheels_apart_ns: int | None = None


NO_DEVIATION = Observed()


class _Deviation(NamedTuple):
    """Deviation of a controller's echo; None, 0 and 0 where it obeys."""

    above: ThrottleExcess | None = None
    below: int = 0
    direction: int = 0

    def with_worse_of(self, other: "_Deviation") -> "_Deviation":
        """The worse of both in each respect."""
        if not any(other):
            return self
        excesses = [one for one in (self.above, other.above) if one]
        return _Deviation(
            max(excesses, default=None),
            max(self.below, other.below),
            max(self.direction, other.direction),
        )


class _Echo:
    """Echo of one controller's commands.

    Attributes:
        standing: deviation of its latest frame; one out of order never is the latest.
    """

    def __init__(self) -> None:
        self.standing = _Deviation()
        self._latest_ns = -math.inf

    def worst(
        self,
        echoed: Sequence[tuple[int, float, float]],
        sent: Sequence[SentValues],
        below_max_pct: float,
    ) -> _Deviation:
        """Take frames: arrival, throttle, direction; the worst of each."""
        worst = _Deviation()
        for at_ns, throttle_pct, direction in echoed:
            before = self.standing
            low = _too_low(sent, at_ns, throttle_pct, below_max_pct)
            wrong = _not_commanded(sent, at_ns, direction)
            deviation = _Deviation(
                _excess(sent, at_ns, throttle_pct),
                before.below + 1 if low else 0,
                before.direction + 1 if wrong else 0,
            )
            worst = worst.with_worse_of(deviation)
            if at_ns >= self._latest_ns:
                self._latest_ns, self.standing = at_ns, deviation
            else:
                worst = worst.with_worse_of(before)
        return worst


def _commanded(sent: Sequence[SentValues], at_ns: int, window_ns: int) -> Iterator[SentValues]:
    """Values sent within this time before, the latest first: it decides almost always."""
    from_ns = at_ns - window_ns
    return (one for one in reversed(sent) if from_ns <= one.at_ns <= at_ns)


def _excess(sent: Sequence[SentValues], at_ns: int, echoed_pct: float) -> ThrottleExcess | None:
    """More throttle than any commanded in the second before."""
    if echoed_pct <= _ABOVE_MAX_PCT:
        return None
    highest_pct = 0.0
    for one in _commanded(sent, at_ns, _THROTTLE_WINDOW_NS):
        if echoed_pct <= one.throttle_pct + _ABOVE_MAX_PCT:
            return None
        highest_pct = max(highest_pct, one.throttle_pct)
    return ThrottleExcess(echoed_pct, highest_pct)


def _too_low(
    sent: Sequence[SentValues], at_ns: int, echoed_pct: float, below_max_pct: float
) -> bool:
    """Less throttle than the lowest commanded in the whole second before."""
    window = at_ns, _THROTTLE_WINDOW_NS
    for one in _commanded(sent, *window):
        if one.throttle_pct - echoed_pct <= below_max_pct:
            return False
    # Before our first frame nothing was commanded.
    return _any_commanded(sent, *window) and sent[0].at_ns <= at_ns - _THROTTLE_WINDOW_NS


def _not_commanded(sent: Sequence[SentValues], at_ns: int, echoed: float) -> bool:
    """A direction that no command of the time before had, where there was one."""
    window = at_ns, _DIRECTION_WINDOW_NS
    for one in _commanded(sent, *window):
        if one.reverse is bool(echoed):
            return False
    return _any_commanded(sent, *window)


def _any_commanded(sent: Sequence[SentValues], at_ns: int, window_ns: int) -> bool:
    return next(_commanded(sent, at_ns, window_ns), None) is not None


class _Steps:
    """Changes of one value from frame to frame."""

    def __init__(self) -> None:
        self._before: tuple[int, float] | None = None

    def out_of_order(self, at_ns: int) -> bool:
        """True for a frame older than the one before: it is no next step of anything."""
        return self._before is not None and at_ns < self._before[0]

    def step(
        self, at_ns: int, value: float, max_change: float, within_ns: float = math.inf
    ) -> float | None:
        """The change since the frame before, where it is too large for so short a time.

        None where it is not, for the first frame and for one out of order.
        """
        before = self._before
        if before is not None and at_ns < before[0]:
            return None
        self._before = (at_ns, value)
        if before is None or at_ns - before[0] > within_ns:
            return None
        change = abs(value - before[1])
        return change if change > max_change else None


class _Speed:
    """The speed of one motor: not believed from a step until enough plausible frames came."""

    def __init__(self) -> None:
        self._steps = _Steps()
        self._plausible_left = 0
        self._step_rpm = 0.0

    def doubt(self, frames: Sequence[LatestFrame], index: int, step_max_rpm: float) -> float | None:
        """Take these frames; the step for which one of them is not believed, None where all are.

        `index` is the speed's among the values of a frame.
        """
        doubted = not frames and self._plausible_left > 0
        for frame in frames:
            at_ns, speed_rpm = frame.arrival_ns, frame.decoded.values[index]
            step_rpm = self._steps.step(at_ns, speed_rpm, step_max_rpm, _STEP_WITHIN_NS)
            if step_rpm is not None:
                self._plausible_left, self._step_rpm = _PLAUSIBLE_FRAMES, step_rpm
            elif self._plausible_left > 0 and not self._steps.out_of_order(at_ns):
                self._plausible_left -= 1
            doubted = doubted or self._plausible_left > 0
        return self._step_rpm if doubted else None


class Plausibility:
    """Plausibility of echoes, motor speeds and wheel speeds, from tick to tick."""

    def __init__(self) -> None:
        self._echoes = {name: _Echo() for name in CONTROLLERS}
        self._speeds = {name: _Speed() for name in CONTROLLERS}
        self._wheels = {name: _Steps() for name in WHEELS}
        self._wheels_apart_since_ns: int | None = None

    def observe(self, snapshot: Snapshot, history: History, settings: Settings) -> Observed:
        """Look at every frame since the tick before."""
        deviations = self._echo_deviations(snapshot, history, settings.echo_below_max_pct)
        speed_steps = self._speed_steps(snapshot, settings.motor_speed_step_max_rpm)
        wheel_steps, apart_ns = self._wheel_steps(snapshot, settings)
        if not (deviations or speed_steps or wheel_steps or apart_ns is not None):
            return NO_DEVIATION
        return Observed(
            {name: one.above for name, one in deviations.items() if one.above},
            {name: one.below for name, one in deviations.items() if one.below},
            frozenset(name for name, echo in self._echoes.items() if echo.standing.below),
            {name: one.direction for name, one in deviations.items() if one.direction},
            speed_steps,
            wheel_steps,
            apart_ns,
        )

    def _echo_deviations(
        self, snapshot: Snapshot, history: History, below_max_pct: float
    ) -> Mapping[str, _Deviation]:
        deviations = {}
        for name, echo in self._echoes.items():
            worst = echo.standing
            if snapshot.arrived(_STATUS1[name]):
                echoed = _pairs(snapshot, _STATUS1[name], "Throttle", "MotorReverse")
                worst = echo.worst(echoed, history.get(name, ()), below_max_pct)
            if any(worst):
                deviations[name] = worst
        return deviations

    def _speed_steps(self, snapshot: Snapshot, step_max_rpm: float) -> Mapping[str, float]:
        steps = {}
        for name, speed in self._speeds.items():
            message = _STATUS2[name]
            index = snapshot.index(message, "MotorSpeed")
            step_rpm = speed.doubt(snapshot.arrived(message), index, step_max_rpm)
            if step_rpm is not None:
                steps[name] = step_rpm
        return steps

    def _wheel_steps(
        self, snapshot: Snapshot, settings: Settings
    ) -> tuple[Mapping[str, float], int | None]:
        """Steps of the wheels in this tick; for how long they differ, or did in it, in ns."""
        steps: dict[str, float] = {}
        if not snapshot.arrived(WHEELS_MESSAGE) and self._wheels_apart_since_ns is None:
            return steps, None
        apart_ns: list[int] = []
        max_kmh = settings.wheel_speed_step_max_kmh
        for at_ns, left_kmh, right_kmh in _pairs(snapshot, WHEELS_MESSAGE, *WHEELS):
            if self._wheels[WHEELS[0]].out_of_order(at_ns):
                continue
            if abs(left_kmh - right_kmh) <= settings.wheel_speed_difference_max_kmh:
                self._wheels_apart_since_ns = None
            else:
                self._wheels_apart_since_ns = self._wheels_apart_since_ns or at_ns
                apart_ns.append(at_ns - self._wheels_apart_since_ns)
            for wheel, speed_kmh in zip(WHEELS, (left_kmh, right_kmh), strict=True):
                step_kmh = self._wheels[wheel].step(at_ns, speed_kmh, max_kmh)
                if step_kmh is not None:
                    steps[wheel] = max(step_kmh, steps.get(wheel, step_kmh))
        if self._wheels_apart_since_ns is not None:
            apart_ns.append(snapshot.now_ns - self._wheels_apart_since_ns)
        return steps, max(apart_ns, default=None)


def _pairs(
    snapshot: Snapshot, message: str, first: str, second: str
) -> list[tuple[int, float, float]]:
    """Arrival in ns and the values of two signals, of each frame since the tick before."""
    one, other = snapshot.index(message, first), snapshot.index(message, second)
    return [
        (frame.arrival_ns, frame.decoded.values[one], frame.decoded.values[other])
        for frame in snapshot.arrived(message)
    ]


SpeedsRpm = tuple[float | None, ...]


class MotorSpeeds(NamedTuple):
    """Lowest and highest speed of each motor in the frames since the tick before.

    None where one of them is out of range or follows a step that no motor makes, or the last
    one is stale.
    """

    lowest_rpm: SpeedsRpm
    highest_rpm: SpeedsRpm


UNKNOWN = MotorSpeeds(*[(None,) * len(CONTROLLERS)] * 2)


def of(snapshot: Snapshot, observed: Observed) -> MotorSpeeds:
    lowest: list[float | None] = []
    highest: list[float | None] = []
    for name, message in _STATUS2.items():
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
