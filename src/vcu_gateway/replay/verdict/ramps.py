"""Ramps: the highest power and brake that may be commanded now."""

from vcu_gateway.replay.verdict.expected_effects import POWER_LIMIT, REGEN_LIMIT, REGEN_OFF
from vcu_gateway.replay.verdict.limits import VerdictLimits
from vcu_gateway.replay.verdict.wire import CONTROLLERS, PERCENT_PER_BIT

_FULL_PCT = 100.0
_HIGHEST_RAW = 255


class LimitRamps:
    """Limits of both controllers on their way along the slews.

    Attributes:
        power_w, brake_pct: by controller.
    """

    def __init__(self, limits: VerdictLimits) -> None:
        self.power_w = dict.fromkeys(CONTROLLERS, limits.power_limit_max_w)
        self.brake_pct = dict.fromkeys(CONTROLLERS, _FULL_PCT)

    def move(
        self,
        effects: set[str],
        limits: VerdictLimits,
        told: dict[str, bytes],
        elapsed_s: float,
    ) -> None:
        """One tick; `told` are the commands that left last, a falling limit starts from them."""
        power_w, brake_pct = limits.power_limit_max_w, _FULL_PCT
        if POWER_LIMIT in effects:
            power_w = min(limits.derated_power_w, power_w)
        if REGEN_LIMIT in effects:
            brake_pct = limits.regen_limit_pct
        power_step_w = limits.power_slew_w_per_s * elapsed_s
        brake_step_pct = limits.regen_slew_pct_per_s * elapsed_s
        for name in CONTROLLERS:
            data = told.get(name, bytes(8))
            told_pct = _FULL_PCT if data[2] == _HIGHEST_RAW else data[2] * PERCENT_PER_BIT
            told_w = data[6] | data[7] << 8
            self.power_w[name] = _moved(self.power_w[name], told_w, power_w, power_step_w)
            self.brake_pct[name] = _moved(self.brake_pct[name], told_pct, brake_pct, brake_step_pct)
            if REGEN_OFF in effects:
                self.brake_pct[name] = 0.0


def _moved(limit: float, told: float, target: float, step: float) -> float:
    if target >= limit:
        return min(target, limit + step)
    return max(target, min(limit, told) - step)
