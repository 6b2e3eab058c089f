"""Caps: the most that each field of a command may be, whoever says so.

Effects of causes, curves, drive modes and the slip limiter all give caps of this kind; of several
the lowest counts, and none of them can raise a field.
"""

import math
from collections.abc import Set
from typing import NamedTuple

from vcu_gateway.core.causes import Effect
from vcu_gateway.core.demand import PowerMode
from vcu_gateway.core.settings import Settings

FULL_PCT = 100.0

_ONLY_TOLD = frozenset({Effect.ALARM, Effect.CAP})
_RISING = (PowerMode.SAFETY, PowerMode.ECO, PowerMode.NORMAL, PowerMode.TURBO)


class Caps(NamedTuple):
    """Caps of one controller's command; each field's default is no cap.

    Attributes:
        throttle_pct: it acts at once. The others may have ramps, which are the commander's.
        throttle_rise_pct_per_s: steepest rise of the throttle.
    """

    throttle_pct: float = FULL_PCT
    throttle_rise_pct_per_s: float = math.inf
    brake_pct: float = FULL_PCT
    power_w: float = math.inf
    speed_rpm: float = math.inf
    power_mode: PowerMode = PowerMode.TURBO

    def lowest(self, other: "Caps") -> "Caps":
        """The lower cap of both, field by field."""
        return Caps(
            min(self.throttle_pct, other.throttle_pct),
            min(self.throttle_rise_pct_per_s, other.throttle_rise_pct_per_s),
            min(self.brake_pct, other.brake_pct),
            min(self.power_w, other.power_w),
            min(self.speed_rpm, other.speed_rpm),
            lower_mode(self.power_mode, other.power_mode),
        )


NO_CAPS = Caps()


def lower_mode(one: PowerMode, other: PowerMode) -> PowerMode:
    """The power mode of two that allows less."""
    if one is other:
        return one
    return min(one, other, key=_RISING.index)


def of_effects(effects: Set[Effect], settings: Settings) -> Caps:
    """What the effects of causes allow (docs/safety.md, Effects); STOP and CUT are modes."""
    if effects <= _ONLY_TOLD:
        return NO_CAPS
    power_w, brake_pct, power_mode = math.inf, FULL_PCT, PowerMode.TURBO
    if Effect.TURBO_OFF in effects:
        power_mode = PowerMode.NORMAL
    if Effect.POWER_LIMIT in effects:
        power_w, power_mode = settings.derated_power_w, PowerMode.ECO
    if Effect.REGEN_LIMIT in effects:
        brake_pct = settings.regen_limit_pct
    if Effect.REGEN_OFF in effects:
        brake_pct = 0.0
    return Caps(brake_pct=brake_pct, power_w=power_w, power_mode=power_mode)
