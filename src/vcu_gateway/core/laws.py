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
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.deratings import Deratings
from vcu_gateway.core.law_inputs import Front, LawInputs, front_speed
from vcu_gateway.core.tuning import Limit, SlipLimiter, Tuning
from vcu_gateway.units import NS_PER_MS

SLIP_KEY = "laws.slip"
_NO_LIMIT = math.inf
_NO_MODES: Mapping[Limit, float] = {}
_UNCUT_PCT: Mapping[str, float] = dict.fromkeys(CONTROLLERS, FULL_PCT)


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
        self._kept: tuple[tuple[object, ...], Mapping[str, Caps]] | None = None

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Laws):
            return NotImplemented
        own, others = ((one.deratings.held, one.modes, one.slip) for one in (self, other))
        return own == others

    __hash__ = None  # type: ignore[assignment]  # what it remembers changes

    def tick(self, inputs: LawInputs) -> LawResult:
        """The caps of a tick; once a tick, and not at all where nothing is configured."""
        tuning = inputs.settings.tuning
        modes = self.modes
        changed = None if modes.current == modes.requested else modes.settle(inputs)
        limits, findings = self.deratings.tick(inputs, modes.limits(tuning))
        reads_speed = tuning.slip is not None or modes.over_speed(tuning)
        front = front_speed(inputs.snapshot) if reads_speed else None
        caps = self._of_mode(inputs, front, limits)
        if tuning.slip is not None:
            throttles, found = self.slip.tick(tuning.slip, inputs, front)
            if found:
                findings = [*findings, *found]
                caps = {
                    name: one._replace(throttle_pct=min(one.throttle_pct, throttles[name]))
                    for name, one in caps.items()
                }
        return LawResult(caps, findings, changed)

    def _of_mode(self, inputs: LawInputs, front: Front | None, limits: Caps) -> Mapping[str, Caps]:
        """Caps of the drive mode: those of the tick before, unless what gives them has changed."""
        tuning = inputs.settings.tuning
        given = tuning, self.modes.current, front, limits, inputs.demanded
        if self._kept is not None and self._kept[0] == given:
            return self._kept[1]
        caps = self.modes.caps(inputs, front, limits)
        steps = front is None and self.modes.over_speed(tuning)
        self._kept = None if steps else (given, caps)
        return caps


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
        """Take the requested mode, another one, where that makes no step; its name if so."""
        if inputs.active and not inputs.released:
            return None
        self.current = self.requested
        return self.current

    def limits(self, tuning: Tuning) -> Mapping[Limit, float]:
        """Limits of fields that have ramps: the lower ones of both modes, from the request on."""
        if self.current is None:
            return _NO_MODES
        own, asked = tuning.mode_limits[self.current], tuning.mode_limits[self.requested or ""]
        if own is asked:
            return own
        return {limit: min(own[limit], asked[limit]) for limit in own}

    def over_speed(self, tuning: Tuning) -> bool:
        """True where one of the mode's curves is over the vehicle's speed."""
        mode = tuning.modes.get(self.current or "")
        return mode is not None and not (mode.by_speed is None and mode.rise_by_speed is None)

    def caps(self, inputs: LawInputs, front: Front | None, limits: Caps) -> Mapping[str, Caps]:
        """These limits with those of throttle, its rise and the power mode, by controller."""
        if self.current is None:
            return dict.fromkeys(CONTROLLERS, limits)
        mode = inputs.settings.tuning.modes[self.current]
        step_pct = inputs.settings.throttle_slew_pct_per_s * inputs.elapsed_s
        self.by_speed_pct = _over_speed(mode.by_speed, front, self.by_speed_pct, step_pct)
        self.rise_pct_per_s = _over_speed(mode.rise_by_speed, front, self.rise_pct_per_s, step_pct)
        most_pct = FULL_PCT if self.by_speed_pct is None else self.by_speed_pct
        own = (
            _NO_LIMIT if self.rise_pct_per_s is None else self.rise_pct_per_s,
            limits.brake_pct,
            limits.power_w,
            limits.speed_rpm,
            mode.power_mode_max,
        )
        if mode.by_pedal is None or inputs.demanded is None:
            return dict.fromkeys(CONTROLLERS, Caps(most_pct, *own))
        mapped: dict[float, Caps] = {}  # mostly both have the same demand
        caps: dict[str, Caps] = {}
        for name, one in inputs.demanded.items():
            asked_pct = one.throttle_pct
            if asked_pct not in mapped:
                mapped[asked_pct] = Caps(min(most_pct, mode.by_pedal.at(asked_pct)), *own)
            caps[name] = mapped[asked_pct]
        return caps


def _over_speed(
    curve: Curve | None, front: Front | None, before: float | None, step: float
) -> float | None:
    """A curve over speed, if any; without a speed it goes step by step to its lowest value."""
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

    caps_pct: Mapping[str, float] = field(default_factory=lambda: _UNCUT_PCT)
    cut_ns: dict[str, int] = field(default_factory=dict)

    def tick(
        self, slip: SlipLimiter, inputs: LawInputs, front: Front | None
    ) -> tuple[Mapping[str, float], list[Finding]]:
        """Cap of each controller's throttle in %, and a finding of each that limits."""
        if not inputs.active:
            self.caps_pct, self.cut_ns = _UNCUT_PCT, {}
            return self.caps_pct, []
        spinning = self._spinning(slip, inputs, front)
        if True not in spinning and self.caps_pct == _UNCUT_PCT:
            return self.caps_pct, []
        caps_pct = {
            name: self._cap_pct(slip, name, one, inputs)
            for name, one in zip(CONTROLLERS, spinning, strict=True)
        }
        most_pct = min(caps_pct.values()) + slip.asymmetry_max_pct
        self.caps_pct = {name: min(cap, most_pct) for name, cap in caps_pct.items()}
        findings = [
            Finding(SLIP_KEY, f"slip of {name}", Effect.CAP, f"throttle at most {cap:.0f} %")
            for name, cap in self.caps_pct.items()
            if cap < FULL_PCT
        ]
        return self.caps_pct, findings

    def _spinning(
        self, slip: SlipLimiter, inputs: LawInputs, front: Front | None
    ) -> list[bool | None]:
        """Whether each driven wheel is faster than allowed; None where a speed is not known."""
        if front is None:
            return [None] * len(inputs.motor_rpm)
        if front.saturated:
            return [False] * len(inputs.motor_rpm)
        allowed_kmh = front.kmh * (1 + slip.allowed_pct / FULL_PCT) + slip.allowed_kmh
        rpm_per_kmh = inputs.settings.tuning.motor_rpm_per_kmh or _NO_LIMIT
        return [
            None if rpm is None else rpm / rpm_per_kmh > allowed_kmh for rpm in inputs.motor_rpm
        ]

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
        given_pct = min(inputs.last[name].throttle_pct, before_pct)
        return max(slip.lowest_throttle_pct, (1 - slip.cut_share_pct / FULL_PCT) * given_pct)
