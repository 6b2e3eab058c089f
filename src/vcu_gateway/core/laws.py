"""Laws: curves, drive mode and slip limiter give the caps of a tick (docs/safety.md, Tuning).

What they know is the snapshot, the demand and what they remember; they command nothing. Of all
that they find the lowest counts, and the ramps to it are the commander's.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from vcu_gateway.core.caps import FULL_PCT, Caps
from vcu_gateway.core.causes import Effect, Finding
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemands
from vcu_gateway.core.law_inputs import Front, InputReader, front_speed
from vcu_gateway.core.plausibility import SpeedsRpm
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Snapshot
from vcu_gateway.core.tuning import (
    DERATINGS,
    Derating,
    Limit,
    SlipLimiter,
    Tuning,
)
from vcu_gateway.units import NS_PER_MS

RELEASED_PCT = 5.0
"""A demanded throttle below it is released."""

SLIP_KEY = "laws.slip"
_MOTOR_TEMPERATURE = "motor_temperature_c"
_MOTORS_APART_MAX_C = 40.0
_NO_LIMIT = math.inf


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


class LawResult(NamedTuple):
    """Caps of each controller, and what there is to tell of them.

    Attributes:
        mode_changed: the drive mode that counts from this tick on; None where it did before.
    """

    caps: Mapping[str, Caps]
    findings: Sequence[Finding]
    mode_changed: str | None


class Laws:
    """Curves, drive mode and slip limiter, from tick to tick; equal ones remember the same."""

    def __init__(self, tuning: Tuning) -> None:
        self.deratings = Deratings()
        self.modes = DriveModes(tuning.start, tuning.start)
        self.slip = SlipLaw()

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Laws):
            return NotImplemented
        own, others = ((one.deratings.held, one.modes, one.slip) for one in (self, other))
        return own == others

    __hash__ = None  # type: ignore[assignment]  # what it remembers changes

    def tick(self, inputs: LawInputs) -> LawResult:
        """The caps of a tick; once a tick, and not at all where nothing is configured."""
        tuning = inputs.settings.tuning
        limits, findings = self.deratings.tick(inputs)
        caps = dict.fromkeys(CONTROLLERS, limits)
        changed, front = None, None
        if tuning.modes or tuning.slip is not None:
            front = front_speed(inputs.snapshot)
        if tuning.modes:
            changed = self.modes.settle(inputs)
            own = self.modes.caps(inputs, front)
            limits = self.deratings.returned(self.modes.ramped(tuning), inputs)
            caps = {name: one.lowest(limits).lowest(own[name]) for name, one in caps.items()}
        if tuning.slip is not None:
            throttles, found = self.slip.tick(tuning.slip, inputs, front)
            findings += found
            caps = {
                name: one._replace(throttle_pct=min(one.throttle_pct, throttles[name]))
                for name, one in caps.items()
            }
        return LawResult(caps, findings, changed)


class CurveState(NamedTuple):
    """A curve in the last tick.

    Attributes:
        x: its input; None where that is not known.
        cap: the limit that it gives, in the unit of the curve; None before the first tick.
    """

    name: str
    x: float | None
    cap: float | None


class Deratings:
    """Limits of fields that have ramps: they fall at once and return slowly.

    Attributes:
        held: each limit as it is now, by a curve's name or that of a drive mode's limit.
        worst: each curve's input in the last tick; None where it was not known.
    """

    def __init__(self) -> None:
        self.held: dict[str, float] = {}
        self.worst: dict[str, float | None] = {}
        self._readers: dict[str, InputReader] = {}
        self._told: dict[str, tuple[float | None, float, Finding]] = {}

    def tick(self, inputs: LawInputs) -> tuple[Caps, list[Finding]]:
        """Caps of every curve; a finding of each that limits or whose input is not known."""
        curves = inputs.settings.tuning.curves
        for name in self._taken_away(curves):
            del self.held[name]
        lowest: dict[Limit, float] = {}
        findings: list[Finding] = []
        for name, curve in curves.items():
            derating = DERATINGS[name]
            x = self.worst[name] = self._worst(derating, inputs.snapshot)
            cap = self._held(name, derating.limit, None if x is None else curve.at(x), inputs)
            lowest[derating.limit] = min(cap, lowest.get(derating.limit, _NO_LIMIT))
            if inputs.told and (x is None or cap < curve.highest):
                findings.append(self._finding(derating, x, cap))
        return _ramped(lowest), [*findings, *self._differences(inputs.snapshot)]

    def _differences(self, snapshot: Snapshot) -> Sequence[Finding]:
        """Motors whose temperatures differ: one of two thermometers may be broken."""
        reader = self._readers.get(_MOTOR_TEMPERATURE)
        span = None if reader is None else reader.span(snapshot)
        if span is None or span[1] - span[0] <= _MOTORS_APART_MAX_C:
            return ()
        detail = f"differ by {span[1] - span[0]:.0f} °C"
        cause, subject = "motor_temperature_difference", "motor temperatures"
        return [Finding(cause, subject, Effect.ALARM, detail)]

    def _taken_away(self, curves: Mapping[str, Curve]) -> list[str]:
        """Curves that a reload took away; one that comes again begins anew."""
        return [name for name in self.held if name in DERATINGS and name not in curves]

    def returned(self, targets: Mapping[Limit, float], inputs: LawInputs) -> Caps:
        """Caps on the way back to these targets, those of the drive mode."""
        held = self._held
        return _ramped(
            {
                limit: held(f"drive_modes.{limit}", limit, one, inputs)
                for limit, one in targets.items()
            }
        )

    def _held(self, name: str, limit: Limit, target: float | None, inputs: LawInputs) -> float:
        """The limit now: at most the target, and in ACTIVE at most on its way back to it.

        Without a target, where the input is not known, it is at most what it was, in every mode.
        """
        held, settings = self.held.get(name, _NO_LIMIT), inputs.settings
        if target is None:
            held = min(held, _fallback(limit, settings))
        elif target <= held or not inputs.active:
            held = target
        else:
            held = min(target, held + _return_per_s(limit, settings) * inputs.elapsed_s)
        self.held[name] = held
        return held

    def _worst(self, derating: Derating, snapshot: Snapshot) -> float | None:
        key = derating.input.quantity.key
        reader = self._readers.get(key)
        if reader is None:
            reader = self._readers[key] = InputReader(derating.input)
        span = reader.span(snapshot)
        return None if span is None else span[not derating.rises]

    def _finding(self, derating: Derating, x: float | None, cap: float) -> Finding:
        told = self._told.get(derating.name)
        if told is not None and told[:2] == (x, cap):
            return told[2]
        quantity = derating.input.quantity
        value = "not known" if x is None else f"{x:.4g} {quantity.unit}"
        detail = f"{value}: {_at_most(derating.limit, cap)}"
        finding = Finding(derating.key, quantity.text, Effect.CAP, detail)
        self._told[derating.name] = x, cap, finding
        return finding


def _ramped(lowest: Mapping[Limit, float]) -> Caps:
    return Caps(
        brake_pct=lowest.get("brake_pct", FULL_PCT),
        power_w=lowest.get("power_limit_w", _NO_LIMIT),
        speed_rpm=lowest.get("speed_limit_rpm", _NO_LIMIT),
    )


def _fallback(limit: Limit, settings: Settings) -> float:
    """The limit where its input is not known."""
    if limit == "power_limit_w":
        return settings.derated_power_w
    return settings.regen_limit_pct if limit == "brake_pct" else _NO_LIMIT


def _return_per_s(limit: Limit, settings: Settings) -> float:
    if limit == "power_limit_w":
        return settings.power_return_w_per_s
    if limit == "brake_pct":
        return settings.brake_return_pct_per_s
    return settings.speed_return_rpm_per_s


def _at_most(limit: Limit, cap: float) -> str:
    if limit == "power_limit_w":
        return f"power at most {cap / 1000:.1f} kW"
    if limit == "brake_pct":
        return f"brake at most {cap:.0f} %"
    return "speed not limited" if cap == _NO_LIMIT else f"speed at most {cap:.0f} rpm"


@dataclass
class DriveModes:
    """The drive mode, and the one that waits for the pedal's release.

    Attributes:
        current: the one whose pedal map, rise and power mode count; None where there are none.
        requested: the one that was asked for last.
        by_speed_pct, rise_pct_per_s: what the curves over speed gave last; None without one.
    """

    current: str | None
    requested: str | None
    by_speed_pct: float | None = None
    rise_pct_per_s: float | None = None

    def settle(self, inputs: LawInputs) -> str | None:
        """Take the requested mode where that makes no step; its name where it is another one."""
        if self.current == self.requested or (inputs.active and not inputs.released):
            return None
        self.current = self.requested
        return self.current

    def ramped(self, tuning: Tuning) -> Mapping[Limit, float]:
        """Limits of fields that have ramps: the lower ones of both modes, from the request on."""
        lowest: dict[Limit, float] = {}
        for name in {self.current, self.requested}:
            mode = tuning.modes[name or ""]
            speed_rpm = (mode.speed_limit_kmh or _NO_LIMIT) * (tuning.motor_rpm_per_kmh or 1.0)
            limits: dict[Limit, float | None] = {
                "power_limit_w": mode.power_limit_w,
                "brake_pct": mode.brake_max_pct,
                "speed_limit_rpm": speed_rpm,
            }
            for limit, own in limits.items():
                lowest[limit] = min(lowest.get(limit, _NO_LIMIT), _NO_LIMIT if own is None else own)
        return lowest

    def caps(self, inputs: LawInputs, front: Front | None) -> Mapping[str, Caps]:
        """Caps of throttle, its rise and the power mode, which act at once, by controller."""
        mode = inputs.settings.tuning.modes[self.current or ""]
        step_pct = inputs.settings.throttle_slew_pct_per_s * inputs.elapsed_s
        self.by_speed_pct = _over_speed(mode.by_speed, front, self.by_speed_pct, step_pct)
        self.rise_pct_per_s = _over_speed(mode.rise_by_speed, front, self.rise_pct_per_s, step_pct)
        by_speed_pct, rise_pct_per_s = self.by_speed_pct, self.rise_pct_per_s
        common = Caps(
            throttle_pct=FULL_PCT if by_speed_pct is None else by_speed_pct,
            throttle_rise_pct_per_s=_NO_LIMIT if rise_pct_per_s is None else rise_pct_per_s,
            power_mode=mode.power_mode_max,
        )
        if mode.by_pedal is None or inputs.demanded is None:
            return dict.fromkeys(CONTROLLERS, common)
        at = mode.by_pedal.at
        return {
            name: common._replace(throttle_pct=min(common.throttle_pct, at(one.throttle_pct)))
            for name, one in inputs.demanded.items()
        }


def _over_speed(
    curve: Curve | None, front: Front | None, before: float | None, step: float
) -> float | None:
    """A curve over speed; without a speed it goes step by step to its lowest value."""
    if curve is None:
        return None
    if front is not None:
        return curve.at(front.kmh)
    return max(curve.lowest, (curve.highest if before is None else before) - step)


@dataclass
class SlipLaw:
    """Slip limiter: cuts the throttle of a wheel that spins, waits, and gives it back slowly.

    Attributes:
        caps_pct: cap of each controller's throttle.
        cut_ns: time of each one's last cut, where it had one in this drive.
    """

    caps_pct: Mapping[str, float] = field(
        default_factory=lambda: dict.fromkeys(CONTROLLERS, FULL_PCT)
    )
    cut_ns: dict[str, int] = field(default_factory=dict)

    def tick(
        self, slip: SlipLimiter, inputs: LawInputs, front: Front | None
    ) -> tuple[Mapping[str, float], list[Finding]]:
        """Cap of each controller's throttle in %, and a finding of each that limits."""
        if not inputs.active:
            self.caps_pct, self.cut_ns = dict.fromkeys(CONTROLLERS, FULL_PCT), {}
            return self.caps_pct, []
        caps_pct = {
            name: self._cap_pct(slip, name, self._is_spinning(slip, inputs, front, rpm), inputs)
            for name, rpm in zip(CONTROLLERS, inputs.motor_rpm, strict=True)
        }
        most_pct = min(caps_pct.values()) + slip.asymmetry_max_pct
        self.caps_pct = {name: min(cap, most_pct) for name, cap in caps_pct.items()}
        findings = [
            Finding(SLIP_KEY, f"slip of {name}", Effect.CAP, f"throttle at most {cap:.0f} %")
            for name, cap in self.caps_pct.items()
            if cap < FULL_PCT
        ]
        return self.caps_pct, findings

    def _is_spinning(
        self, slip: SlipLimiter, inputs: LawInputs, front: Front | None, rpm: float | None
    ) -> bool | None:
        """Whether a driven wheel is faster than allowed; None where a speed is not known."""
        if front is not None and front.saturated:
            return False
        if front is None or rpm is None:
            return None
        allowed_kmh = front.kmh * (1 + slip.allowed_pct / FULL_PCT) + slip.allowed_kmh
        rpm_per_kmh = inputs.settings.tuning.motor_rpm_per_kmh or _NO_LIMIT
        return rpm / rpm_per_kmh > allowed_kmh

    def _cap_pct(
        self, slip: SlipLimiter, name: str, spinning: bool | None, inputs: LawInputs
    ) -> float:
        before_pct, now_ns = self.caps_pct[name], inputs.snapshot.now_ns
        returned_pct = min(FULL_PCT, before_pct + slip.return_pct_per_s * inputs.elapsed_s)
        if spinning is None:
            return returned_pct if inputs.released else before_pct
        if not spinning:
            return returned_pct
        cut_ns = self.cut_ns.get(name)
        if cut_ns is not None and now_ns - cut_ns < slip.wait_ms * NS_PER_MS:
            return before_pct
        self.cut_ns[name] = now_ns
        given_pct = min(inputs.sent_throttle_pct[name], before_pct)
        return max(slip.lowest_throttle_pct, (1 - slip.cut_share_pct / FULL_PCT) * given_pct)
