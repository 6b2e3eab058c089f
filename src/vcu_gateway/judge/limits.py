"""Configured values that a drive is held against; docs/safety.md says what they mean."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

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
_STALE_PERIODS = ((500, 3.2), (100, 3), (50, 4), (0, 10))


def stale_after_ms(period_ms: int) -> int:
    """The same age of a message that another DBC has, by its period."""
    periods = next(periods for least_ms, periods in _STALE_PERIODS if period_ms >= least_ms)
    return int(period_ms * periods)


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


Points = Sequence[Sequence[float]]
"""Curve as [x, y] of each of its points."""

ModeKeys = Mapping[str, Any]
"""Drive mode, by the keys below its name."""


class JudgedSignal(NamedTuple):
    """Signal as the recorded DBC lays it out.

    Attributes:
        positions: its bits in the frame, the least significant first.
        lowest, highest: codes of its range; others, and `saturated`, are not known.
    """

    positions: tuple[int, ...]
    signed: bool
    factor: float
    offset: float
    lowest: int
    highest: int
    saturated: int | None

    def raw(self, bits: int) -> int:
        code = sum((bits >> place & 1) << weight for weight, place in enumerate(self.positions))
        negative = self.signed and code >> len(self.positions) - 1
        return code - (1 << len(self.positions)) if negative else code

    def known_raw(self, bits: int) -> int | None:
        code = self.raw(bits)
        return code if self.lowest <= code <= self.highest and code != self.saturated else None


class JudgedTrack(NamedTuple):
    """Pedal's signal and both ends of its travel."""

    signal: JudgedSignal
    released: float
    pressed: float


class JudgedPedals(NamedTuple):
    """Pedals on CAN.

    Attributes:
        checksum: its byte and its kind.
        coast: points of travel (%) and Brake (%); empty without.
        priorities: of sources.
    """

    can_id: int
    period_ms: int
    throttle: JudgedTrack
    track2: JudgedTrack | None
    brake: JudgedTrack | None
    counter: JudgedSignal | None
    checksum: tuple[int, str] | None
    reverse: JudgedSignal | None
    power_mode: int
    regen_brake: bool
    dead_zone_pct: float
    coast: tuple[tuple[float, float], ...]
    priorities: Mapping[str, int]

    def outranks(self, source: str) -> bool:
        """The pedals take the demand over from this source while that one's is fresh."""
        return self.priorities.get("pedals", 0) > self.priorities.get(source, 0)


@dataclass(frozen=True)
class VerdictLimits:
    """Configuration as far as docs/safety.md has it.

    Attributes:
        stale_after_ms, late_after_ms: by message, where the configuration says otherwise.
        aliases: further identifiers of messages.
        bench_demand: static demand of a test bench; None on a vehicle.
        tuning: curves, drive modes and laws by whole keys, as a recording has them; may be empty.
        pedals: pedals on CAN; None without them.
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
    power_return_w_per_s: float
    brake_return_pct_per_s: float
    speed_fall_rpm_per_s: float
    speed_return_rpm_per_s: float
    tuning: Mapping[str, Any]
    pedals: JudgedPedals | None = None

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

    @cached_property
    def derated(self) -> Mapping[str, float]:
        """Most of each field under its effect, or where the input of its curve is not known."""
        return {
            "power_limit_w": self.derated_power_w,
            "brake_pct": self.regen_limit_pct,
            "speed_limit_rpm": math.inf,
        }

    @cached_property
    def curves(self) -> Mapping[str, Points]:
        """Curves by their keys below `curves`, such as power_limit_w.by_soc_pct."""
        return self._below("curves.")

    @cached_property
    def drive_modes(self) -> Mapping[str, ModeKeys]:
        """Drive modes by name."""
        modes: dict[str, dict[str, Any]] = {}
        for key, value in self._below("drive_modes.modes.").items():
            name, _, own = key.partition(".")
            modes.setdefault(name, {})[own] = value
        return modes

    @property
    def motor_rpm_per_kmh(self) -> float | None:
        return self.tuning.get("vehicle.motor_rpm_per_kmh")

    @cached_property
    def slip(self) -> Mapping[str, float] | None:
        """Settings of the slip limiter by their keys; None where it is off."""
        return self._below("laws.slip.") or None

    @cached_property
    def holds_speed(self) -> bool:
        """A curve or a drive mode may hold SpeedLimit below what is demanded."""
        curves = any(key.startswith("speed_limit_rpm.") for key in self.curves)
        return curves or any(
            mode["speed_limit_kmh"] is not None for mode in self.drive_modes.values()
        )

    def _below(self, prefix: str) -> dict[str, Any]:
        keys = [key for key in self.tuning if key.startswith(prefix)]
        return {key.removeprefix(prefix): self.tuning[key] for key in keys}
