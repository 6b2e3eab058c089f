"""Configured values that a drive is held against; docs/safety.md says what they mean."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from vcu_gateway.judge.wire import MS

STALE_AFTER_MS: Mapping[str, int] = {
    "ARD2_SteeringWheel": 300,
    "BMS_Status": 1600,
    "BMS_Temperatures": 1600,
    "IMU_Acceleration": 100,
    "IMU_AngularRate": 100,
    "IMU_Attitude": 100,
    "PCU1_Status1": 1600,
    "PCU1_Status2": 200,
    "PCU2_Status1": 1600,
    "PCU2_Status2": 200,
}
"""Ages of docs/safety.md, Causes; a configuration may say otherwise."""
BATTERY_LATE_AFTER_MS = 1100


class JudgedDemand(NamedTuple):
    """Demand for one controller, as it was made."""

    throttle_pct: float
    brake_pct: float
    power_mode: int
    motor_reverse: bool
    regen_brake: bool
    speed_limit_rpm: float
    power_limit_w: float
    throttle_track2_pct: float | None = None


JudgedDemands = Mapping[str, JudgedDemand]
"""Demand of each controller, by name."""


@dataclass(frozen=True)
class VerdictLimits:
    """Configuration as far as docs/safety.md has it.

    Attributes:
        stale_after_ms, late_after_ms: by message, where the configuration says otherwise.
        aliases: further identifiers of messages.
        bench_demand: static demand of a test bench; None on a vehicle.
        speed_capped: a curve or a drive mode may have SpeedLimit below what is demanded.
    """

    period_ms: float
    transmit_priority: int
    speed_limit_max_rpm: float
    power_limit_max_w: float
    derated_power_w: float
    regen_limit_pct: float
    throttle_slew_pct_per_s: float
    power_slew_w_per_s: float
    regen_slew_pct_per_s: float
    speed_slew_rpm_per_s: float
    direction_change_rpm: float
    regen_min_rpm: float
    required_messages: tuple[str, ...]
    listen_before_talk_ms: float
    clear_hold_ms: float
    echo_below_max_pct: float
    motor_speed_step_max_rpm: float
    independent_directions: bool
    stale_after_ms: Mapping[str, int]
    late_after_ms: Mapping[str, int]
    aliases: Mapping[int, str]
    bench_demand: JudgedDemands | None
    speed_capped: bool = False

    @cached_property
    def stale_ns(self) -> Mapping[str, int]:
        """Age from which each message counts as missing."""
        ages_ms = {**STALE_AFTER_MS, **self.stale_after_ms}
        return {name: MS * age_ms for name, age_ms in ages_ms.items()}

    @cached_property
    def battery_late_ns(self) -> int:
        return MS * self.late_after_ms.get("BMS_Status", BATTERY_LATE_AFTER_MS)

    @cached_property
    def period_ns(self) -> int:
        return round(self.period_ms * MS)
