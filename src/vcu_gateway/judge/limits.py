"""Configured values that a drive is held against, with the defaults of docs/safety.md."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from vcu_gateway.judge.wire import BATTERY_LATE_AFTER_MS, MS, STALE_AFTER_MS


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
    """

    period_ms: float = 50.0
    transmit_priority: int = 0
    speed_limit_max_rpm: float = 12_000.0
    power_limit_max_w: float = 60_000.0
    derated_power_w: float = 10_000.0
    regen_limit_pct: float = 20.0
    throttle_slew_pct_per_s: float = 100.0
    power_slew_w_per_s: float = 60_000.0
    regen_slew_pct_per_s: float = 100.0
    speed_slew_rpm_per_s: float = 4_000.0
    direction_change_rpm: float = 50.0
    regen_min_rpm: float = 100.0
    required_messages: tuple[str, ...] = ("BMS_Status", "PCU1_Status2", "PCU2_Status2")
    listen_before_talk_ms: float = 1_000.0
    clear_hold_ms: float = 1_000.0
    echo_below_max_pct: float = 15.0
    motor_speed_step_max_rpm: float = 2_000.0
    independent_directions: bool = False
    stale_after_ms: Mapping[str, int] = field(default_factory=dict)
    late_after_ms: Mapping[str, int] = field(default_factory=dict)
    aliases: Mapping[int, str] = field(default_factory=dict)
    bench_demand: JudgedDemands | None = None

    @cached_property
    def stale_ns(self) -> Mapping[str, int]:
        """Age from which each message counts as missing."""
        ages_ms = {**STALE_AFTER_MS, **self.stale_after_ms}
        return {name: MS * age_ms for name, age_ms in ages_ms.items()}

    @cached_property
    def battery_late_ns(self) -> int:
        """Age from which the battery's status is late."""
        return MS * self.late_after_ms.get("BMS_Status", BATTERY_LATE_AFTER_MS)

    @cached_property
    def period_ns(self) -> int:
        """Period of the command frames."""
        return round(self.period_ms * MS)
