"""What the configuration tells the core."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields

from vcu_gateway.core.demand import ControllerDemand

REQUIRED_MESSAGES = ("BMS_Status", "PCU1_Status2", "PCU2_Status2")

# How a limit may change while the vehicle can move: a smaller value is the stricter one,
# except for the holding times.
_STRICTER_IS_SMALLER = (
    "speed_limit_max_rpm",
    "power_limit_max_w",
    "derated_power_w",
    "regen_limit_pct",
    "throttle_slew_pct_per_s",
    "direction_change_rpm",
    "echo_below_max_pct",
    "motor_speed_step_max_rpm",
    "wheel_speed_step_max_kmh",
    "wheel_speed_difference_max_kmh",
    "ttl_max_ms",
    "ttl_default_ms",
)
_STRICTER_IS_LARGER = ("clear_hold_ms", "regen_min_rpm")

RESTART_ONLY = (
    "late_after_ms",
    "stale_after_ms",
    "transmit_priority",
    "period_ns",
    "listen_before_talk_ms",
    "bench_demand",
    "auto_arm",
)
"""What is read once, at the start."""


@dataclass(frozen=True, slots=True)
class Settings:
    """Limits, times and lists; every default is SAFETY.md's.

    Attributes:
        late_after_ms, stale_after_ms: overrides by message name.
        transmit_priority: J1939 priority of the command frames, 0..7.
        period_ns: of the command frames.
        required: messages without which nothing moves.
        qualify_frames: good frames of each required message before STANDBY.
        derated_power_w: PowerLimit under a POWER_LIMIT effect.
        regen_limit_pct: Brake under a REGEN_LIMIT effect.
        speed_slew_rpm_per_s: steepest fall of SpeedLimit.
        regen_min_rpm: both motors' least speed for regeneration; 0 switches this off.
        echo_below_max_pct: throttle echoed below the lowest commanded that still is obeying.
        motor_speed_step_max_rpm: largest change between two Status2 that is plausible.
        wheel_speed_step_max_kmh: largest change between two ARD2 frames without an alarm.
        wheel_speed_difference_max_kmh: largest difference of both wheels without an alarm.
        ttl_max_ms: longest time to live that a demand may ask for.
        ttl_default_ms: time to live of a demand that names none.
        priorities: priority by source name; a source that is not listed has 0.
        independent_directions: a demand may ask for two directions.
        second_track_required: a demand must carry the pedal's second track.
        bench_demand: static demand for both controllers on a test bench; None on a vehicle.
        auto_arm: arm once by itself, with a bench demand only.
    """

    late_after_ms: Mapping[str, int] = field(default_factory=dict)
    stale_after_ms: Mapping[str, int] = field(default_factory=dict)
    transmit_priority: int = 0
    required: tuple[str, ...] = REQUIRED_MESSAGES
    period_ns: int = 50_000_000
    listen_before_talk_ms: int = 1000
    qualify_frames: int = 3
    clear_hold_ms: int = 1000
    speed_limit_max_rpm: float = 12000.0
    power_limit_max_w: float = 60000.0
    derated_power_w: float = 10000.0
    regen_limit_pct: float = 20.0
    throttle_slew_pct_per_s: float = 100.0
    power_slew_w_per_s: float = 60000.0
    regen_slew_pct_per_s: float = 100.0
    speed_slew_rpm_per_s: float = 4000.0
    direction_change_rpm: float = 50.0
    regen_min_rpm: float = 100.0
    echo_below_max_pct: float = 15.0
    motor_speed_step_max_rpm: float = 2000.0
    wheel_speed_step_max_kmh: float = 20.0
    wheel_speed_difference_max_kmh: float = 15.0
    ttl_max_ms: int = 1000
    ttl_default_ms: int = 200
    priorities: Mapping[str, int] = field(default_factory=dict)
    independent_directions: bool = False
    second_track_required: bool = False
    bench_demand: ControllerDemand | None = None
    auto_arm: bool = False


def changed(before: Settings, after: Settings) -> tuple[str, ...]:
    """Names of what differs."""
    names = [item.name for item in fields(Settings)]
    return tuple(name for name in names if getattr(before, name) != getattr(after, name))


def loosened(before: Settings, after: Settings) -> tuple[str, ...]:
    """Names of what `after` changes otherwise than towards a stricter limit."""
    return tuple(
        item.name
        for item in fields(Settings)
        if not _as_strict(item.name, getattr(before, item.name), getattr(after, item.name))
    )


def _as_strict(name: str, before: object, after: object) -> bool:
    if name in _STRICTER_IS_SMALLER:
        return float(str(after)) <= float(str(before))
    if name in _STRICTER_IS_LARGER:
        return float(str(after)) >= float(str(before))
    return before == after
