"""Tuning: what curves, drive modes and the slip limiter allow a command at most.

docs/safety.md, Tuning, in the judge's own reading. Each cap is an upper bound: what the judge
cannot know, as where a recording begins in the middle, caps nothing.
"""

import math
from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

from vcu_gateway.judge.arrivals import Arrivals
from vcu_gateway.judge.demands import GrantedDemands
from vcu_gateway.judge.limits import ModeKeys, Points, VerdictLimits
from vcu_gateway.judge.wire import (
    CONTROLLERS,
    HIGHEST_RAW,
    INPUTS,
    MOTOR_SPEED,
    MS,
    PERCENT_PER_BIT,
    POWER_MODES,
    WHEEL_SPEEDS,
    ReceivedSignals,
)

_FULL_PCT, _RELEASED_PCT = 100.0, 5.0
_SPEED_LIMIT_MIN_RPM = 500
_WHEELS = "ARD2_SteeringWheel"
_SATURATED_RAW = WHEEL_SPEEDS.highest_raw
# So near to its limit a wheel slips or not by the order of the arithmetic alone.
_NEAR_KMH = 1e-6


class TuningCaps(NamedTuple):
    """Most that a command may have in a tick; infinite where nothing caps it.

    Attributes:
        power_mode: code of the highest PowerMode.
        throttle_pct: by controller.
    """

    power_w: float = math.inf
    brake_pct: float = math.inf
    speed_rpm: float = math.inf
    rise_pct_per_s: float = math.inf
    power_mode: int = POWER_MODES.index("turbo")
    throttle_pct: Mapping[str, float] = dict.fromkeys(CONTROLLERS, _FULL_PCT)


class TuningTick(NamedTuple):
    """What the caps of a tick are made from.

    Attributes:
        sent_raw: throttle of the last command that left, by controller.
        elapsed_s: since the tick before, at most a period.
        began_active: the tick begins in ACTIVE and does not end it.
    """

    limits: VerdictLimits
    arrivals: Arrivals
    demands: GrantedDemands
    sent_raw: Mapping[str, int]
    now_ns: int
    elapsed_s: float
    began_active: bool


def value_at(points: Points, x: float) -> float:
    """Linear between the points, level beyond them."""
    for (x0, y0), (x1, y1) in pairwise(points):
        if x <= x0:
            return y0
        if x <= x1:
            return y0 + (y1 - y0) * (x - x0) / (x1 - x0)
    return points[-1][1]


class TuningRules:
    """Memory of curves and drive modes from tick to tick; `complete`: from the start on.

    Attributes:
        drive_mode: the one in force; None where it is not known, or there is none.
        asked: the one that was asked for last.
    """

    def __init__(self, limits: VerdictLimits, *, complete: bool) -> None:
        self.drive_mode: str | None = limits.tuning.get("drive_modes.start") if complete else None
        self.asked = self.drive_mode
        self._complete = complete
        self._held: dict[str, float] = {}
        self._over_speed: dict[str, float] = {}
        self._slip = {name: _SlipCap() for name in CONTROLLERS}

    def begin_in(self, drive_mode: str, limits: VerdictLimits) -> None:
        """The process before had kept this drive mode."""
        if drive_mode in limits.drive_modes:
            self.drive_mode = self.asked = drive_mode

    def ask(self, drive_mode: str, limits: VerdictLimits, *, service: bool) -> str:
        """A drive mode was granted; what is against it, else empty."""
        left = {self.drive_mode, self.asked} - {drive_mode, None}
        self.asked = drive_mode
        for name, keys in limits.drive_modes.items():
            if name in left and keys["left_by_service"] and not service:
                return f"{name} was left below service level"
        return ""

    def reload(self, limits: VerdictLimits) -> None:
        """A curve that is gone is forgotten; a drive mode in use is never dropped."""
        self._held = {
            key: held
            for key, held in self._held.items()
            if key in limits.curves or key.endswith(".mode")
        }

    def tick(self, tick: TuningTick) -> TuningCaps:
        """Most that the commands of a tick may have."""
        if not tick.limits.tuning:
            return TuningCaps()
        self._take_drive_mode(tick)
        self._hold(tick)
        mode: ModeKeys = tick.limits.drive_modes.get(self.drive_mode or "", {})
        speed_kmh, slew_pct_per_s = _speed_kmh(tick), tick.limits.throttle_slew_pct_per_s
        over_pct = self._over(speed_kmh, mode, "throttle_pct", _FULL_PCT, tick)
        rise = self._over(speed_kmh, mode, "throttle_rise_pct_per_s", slew_pct_per_s, tick)
        slip_pct = self._slip_pct(speed_kmh, tick)
        by_pedal = mode.get("throttle_pct.by_pedal_pct")
        throttle_pct = {}
        for name in CONTROLLERS:
            demanded = tick.demands.of(name)
            pedal_pct = _FULL_PCT if demanded is None else demanded.throttle_pct
            mapped_pct = value_at(by_pedal, pedal_pct) if by_pedal else _FULL_PCT
            throttle_pct[name] = min(mapped_pct, over_pct, slip_pct[name])
        power_mode = POWER_MODES.index(mode.get("power_mode_max", "turbo"))
        speed_rpm = max(self._lowest("speed_limit_rpm"), _SPEED_LIMIT_MIN_RPM)
        power_w, brake_pct = self._lowest("power_limit_w"), self._lowest("brake_pct")
        return TuningCaps(power_w, brake_pct, speed_rpm, rise, power_mode, throttle_pct)

    def _take_drive_mode(self, tick: TuningTick) -> None:
        """The mode asked for is in force where that makes no step."""
        if not tick.began_active or (tick.demands.known and _all_released(tick)):
            self.drive_mode = self.asked

    def _hold(self, tick: TuningTick) -> None:
        """What curves and drive modes hold; a drive mode's number is held as a curve's."""
        limits, arrivals = tick.limits, tick.arrivals
        rates = {
            "power_limit_w": limits.power_return_w_per_s,
            "brake_pct": limits.brake_return_pct_per_s,
            "speed_limit_rpm": limits.speed_return_rpm_per_s,
        }
        for key, points in limits.curves.items():
            field, _, name = key.partition(".by_")
            if not self._complete and not all(map(arrivals.came, INPUTS[name].messages)):
                continue  # it may have come before this recording
            values = _values(INPUTS[name], arrivals, tick.now_ns)
            if values is None:
                self._held[key] = min(self._held.get(key, math.inf), limits.derated[field])
            else:
                # A curve goes one way only, so the worst value gives the lowest limit.
                target = min(value_at(points, value) for value in values)
                self._move(key, target, rates[field], tick)
        counting = (self.drive_mode, self.asked)
        modes = [keys for name, keys in limits.drive_modes.items() if name in counting]
        for field, rate in rates.items():
            target = min((_of_mode(mode, field, limits) for mode in modes), default=math.inf)
            self._move(f"{field}.mode", target, rate, tick)

    def _move(self, key: str, target: float, rate: float, tick: TuningTick) -> None:
        held = self._held.get(key, math.inf)
        if tick.began_active:
            target = min(target, held + rate * tick.elapsed_s)
        self._held[key] = target

    def _lowest(self, field: str) -> float:
        held = [one for key, one in self._held.items() if key.startswith(f"{field}.")]
        return min(held, default=math.inf)

    def _over(
        self, speed_kmh: float | None, mode: ModeKeys, field: str, full: float, tick: TuningTick
    ) -> float:
        """Value of a drive mode's curve over speed, `full` where it has none."""
        points = mode.get(f"{field}.by_speed_kmh")
        before = self._over_speed.pop(field, None)
        if not points or (not self._complete and not tick.arrivals.came(_WHEELS)):
            return full
        if speed_kmh is None:
            step = tick.limits.throttle_slew_pct_per_s * tick.elapsed_s
            lowest, *_, highest = sorted(y for _, y in points)
            value: float = max(lowest, (highest if before is None else before) - step)
        else:
            value = value_at(points, speed_kmh)
        self._over_speed[field] = value
        return value

    def _slip_pct(self, front_kmh: float | None, tick: TuningTick) -> Mapping[str, float]:
        """Most throttle of each controller by the slip limiter."""
        caps, slip = self._slip, tick.limits.slip
        if slip is None:
            return dict.fromkeys(CONTROLLERS, _FULL_PCT)
        for name, one in caps.items():
            one.move(name, front_kmh, tick)
        highest_pct = min(one.pct for one in caps.values()) + slip["asymmetry_max_pct"]
        for one in caps.values():
            one.pct = min(one.pct, highest_pct)
        return {name: one.pct for name, one in caps.items()}


def _values(one: ReceivedSignals, arrivals: Arrivals, now_ns: int) -> list[float] | None:
    """Every value since the tick before; None where the input is not known."""
    if any(arrivals.stale(name, now_ns) for name in one.messages):
        return None
    frames = [frame for name in one.messages for frame in arrivals.judged(name)]
    raws = [raw for frame in frames for raw in one.raws(frame.data)]
    if max(raws) > one.highest_raw:
        return None
    return [raw * one.per_bit + one.offset for raw in raws]


def _of_mode(mode: ModeKeys, field: str, limits: VerdictLimits) -> float:
    if field == "brake_pct":
        return float(mode["brake_max_pct"])
    if field == "power_limit_w":
        power_w = mode["power_limit_w"]
        return math.inf if power_w is None else float(power_w)
    speed_kmh, rpm_per_kmh = mode["speed_limit_kmh"], limits.motor_rpm_per_kmh
    return math.inf if speed_kmh is None or rpm_per_kmh is None else float(speed_kmh) * rpm_per_kmh


def _wheels(tick: TuningTick) -> list[list[int]]:
    """Codes of both front wheels in every frame that counts; empty where they are not known."""
    if tick.arrivals.stale(_WHEELS, tick.now_ns):
        return []
    return [WHEEL_SPEEDS.raws(one.data) for one in tick.arrivals.judged(_WHEELS)]


def _speed_kmh(tick: TuningTick) -> float | None:
    """The faster front wheel, of several frames the lowest; saturated it is beyond each curve."""
    return min([max(raws) / 1000 for raws in _wheels(tick)], default=None)


class _SlipCap:
    """Cap of a controller's throttle: cut, wait, return.

    Attributes:
        cut_ns: of its last cut.
        certain_ns: from then on a wheel that slips is certainly cut; None: not known yet.
    """

    def __init__(self) -> None:
        self.pct = _FULL_PCT
        self.cut_ns: int | None = None
        self.certain_ns: float | None = None

    def move(self, name: str, front_kmh: float | None, tick: TuningTick) -> None:
        """One tick of the law where it is certain; else nothing is capped for a while."""
        if not tick.began_active:
            self.pct, self.cut_ns, self.certain_ns = _FULL_PCT, None, -math.inf
            return
        slip = tick.limits.slip or {}
        wait_ns = round(slip["wait_ms"] * MS)
        saturated = any(_SATURATED_RAW in raws for raws in _wheels(tick))
        over_kmh = None if saturated else _over_kmh(name, front_kmh, tick)
        if self.certain_ns is None:
            # The core may know a speed that came before this recording.
            self._unsure(tick.now_ns + wait_ns + tick.limits.stale_ns[_WHEELS])
        elif over_kmh is not None and over_kmh > -_NEAR_KMH:
            if over_kmh <= _NEAR_KMH or tick.now_ns < self.certain_ns:
                self._unsure(tick.now_ns + wait_ns)
            elif self.cut_ns is None or tick.now_ns - self.cut_ns >= wait_ns:
                kept = (1 - slip["cut_share_pct"] / 100) * min(_sent_pct(name, tick), self.pct)
                self.pct, self.cut_ns = max(slip["lowest_throttle_pct"], kept), tick.now_ns
        elif over_kmh is not None or saturated or _all_released(tick):
            self.pct = min(_FULL_PCT, self.pct + slip["return_pct_per_s"] * tick.elapsed_s)

    def _unsure(self, until_ns: float) -> None:
        self.pct, self.cut_ns = _FULL_PCT, None
        self.certain_ns = until_ns if self.certain_ns is None else max(until_ns, self.certain_ns)


def _over_kmh(name: str, front_kmh: float | None, tick: TuningTick) -> float | None:
    """How far a wheel is faster than it may be; None where a speed is not known or believed."""
    rpms = _values(MOTOR_SPEED._replace(messages=(f"{name}_Status2",)), tick.arrivals, tick.now_ns)
    slip, rpm_per_kmh = tick.limits.slip, tick.limits.motor_rpm_per_kmh
    if rpms is None or front_kmh is None or rpm_per_kmh is None or slip is None:
        return None
    if tick.arrivals.is_doubted(name):
        return None
    allowed_kmh = front_kmh * (1 + slip["allowed_pct"] / 100) + slip["allowed_kmh"]
    return max(rpms) / rpm_per_kmh - allowed_kmh


def _sent_pct(name: str, tick: TuningTick) -> float:
    """The throttle sent last, at most: half a bit above its code."""
    raw = tick.sent_raw.get(name, HIGHEST_RAW)
    return _FULL_PCT if raw == HIGHEST_RAW else (raw + 0.5) * PERCENT_PER_BIT


def _all_released(tick: TuningTick) -> bool:
    """Less than 5 % is demanded of every controller, or nothing; also where that is not known."""
    current = tick.demands.current
    if current is None or not current.fresh(tick.now_ns):
        return True
    return all(one.throttle_pct < _RELEASED_PCT for one in current.controllers.values())
