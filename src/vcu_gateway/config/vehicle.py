"""Sections about the vehicle: limits, safety, demand and the test bench."""

from collections.abc import Mapping
from typing import Literal

from pydantic import Field, field_validator

from vcu_gateway.config.value_types import (
    Confirmation,
    MessageName,
    Priority,
    Section,
    SourceName,
    refusal,
)
from vcu_gateway.core.settings import REQUIRED_MESSAGES


class LimitsSection(Section):
    """What a command never exceeds, whoever asks."""

    speed_limit_max_rpm: int = Field(
        default=12_000,
        ge=500,
        le=12_000,
        description="Largest SpeedLimit that is ever sent to a motor controller.",
    )
    power_limit_max_w: int = Field(
        default=60_000,
        ge=0,
        le=60_000,
        description="Largest PowerLimit that is ever sent to a motor controller.",
    )
    derated_power_w: int = Field(
        default=10_000,
        ge=0,
        le=30_000,
        description="PowerLimit while a cause limits the power.",
    )
    regen_limit_pct: float = Field(
        default=20.0,
        ge=0,
        le=50,
        description="Brake while a cause limits regeneration.",
    )
    throttle_slew_pct_per_s: float = Field(
        default=100.0,
        ge=10,
        le=200,
        description="Steepest rise of the throttle; it falls at once.",
    )
    power_slew_w_per_s: float = Field(
        default=60_000.0,
        ge=6_000,
        le=120_000,
        description="How fast a power limit comes and goes.",
    )
    regen_slew_pct_per_s: float = Field(
        default=100.0,
        ge=10,
        le=200,
        description="How fast a regeneration limit comes and goes.",
    )
    speed_slew_rpm_per_s: float = Field(
        default=4_000.0,
        ge=500,
        le=20_000,
        description="Steepest fall of the SpeedLimit; it rises at once.",
    )
    direction_change_rpm: float = Field(
        default=50.0,
        ge=0,
        le=100,
        description="The direction changes only while both motors turn slower than this.",
    )
    regen_min_rpm: float = Field(
        default=100.0,
        ge=0,
        le=1_000,
        description="Both motors turn at least this fast for regeneration; it returns 50 rpm above."
        " 0 switches this off.",
    )


class SafetySection(Section):
    """When the vehicle may move."""

    required_messages: tuple[MessageName, ...] = Field(
        default=REQUIRED_MESSAGES,
        strict=False,
        description="Messages without which nothing moves; the three defaults always belong.",
    )
    listen_before_talk_ms: int = Field(
        default=1000,
        ge=1000,
        le=10_000,
        description="Silence at the start, to hear another sender of the command frames.",
    )
    qualify_frames: int = Field(
        default=3,
        ge=3,
        le=100,
        description="Good frames of each required message before the vehicle may be armed.",
    )
    clear_hold_ms: int = Field(
        default=1000,
        ge=1000,
        le=60_000,
        description="How long a cause must be gone before its effect ends.",
    )
    echo_below_max_pct: float = Field(
        default=15.0,
        ge=5,
        le=50,
        description="Throttle that a controller may echo below the lowest commanded before it"
        " counts as not obeying.",
    )
    motor_speed_step_max_rpm: float = Field(
        default=2_000.0,
        ge=500,
        le=12_000,
        description="Largest change of a motor's speed between two frames that is believed.",
    )
    wheel_speed_step_max_kmh: float = Field(
        default=20.0,
        ge=5,
        le=200,
        description="Largest change of a wheel's speed between two frames that raises no alarm.",
    )
    wheel_speed_difference_max_kmh: float = Field(
        default=15.0,
        ge=1,
        le=200,
        description="Largest difference of both wheels' speeds that raises no alarm.",
    )

    @field_validator("required_messages")
    @classmethod
    def _keeps_the_defaults(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        missing = [name for name in REQUIRED_MESSAGES if name not in names]
        if missing:
            raise refusal(f"must name {', '.join(REQUIRED_MESSAGES)}", f"add {missing[0]}")
        return names


class DemandSection(Section):
    """Who may ask for torque, and for how long a demand counts."""

    ttl_max_ms: int = Field(
        default=1000,
        ge=50,
        le=1000,
        description="Longest time to live that a demand may carry.",
    )
    ttl_default_ms: int = Field(
        default=200,
        ge=50,
        le=1000,
        description="Time to live of a demand that carries none; at most demand.ttl_max_ms, which"
        " is also the default where that is lower.",
    )
    priorities: Mapping[SourceName, Priority] = Field(
        default={},
        description="Priority by source, 0..100; a source that is not listed has 0, the higher"
        " takes over from the lower.",
    )
    independent_directions: bool = Field(
        default=False,
        description="Let a demand ask the motor controllers for different directions.",
    )
    second_track_required: bool = Field(
        default=False,
        description="Refuse a demand that does not carry the pedal's second track.",
    )


class BenchDemandSection(Section):
    """A demand that never ends, for both controllers, without a driver."""

    bench_use_only: Confirmation = Field(
        description="Must be true: it confirms that the wheels are off the ground.",
        json_schema_extra={"const": True},
    )
    throttle_pct: float = Field(default=0.0, ge=0, le=100, description="Throttle pedal.")
    brake_pct: float = Field(default=0.0, ge=0, le=100, description="Brake pedal.")
    power_mode: Literal["eco", "normal", "turbo", "safety"] = Field(
        default="eco", description="The controllers' power mode."
    )
    motor_reverse: bool = Field(default=False, description="Turn the motors in reverse.")
    regen_brake: bool = Field(default=False, description="Recover energy while braking.")
    speed_limit_rpm: int = Field(
        default=12_000,
        ge=0,
        le=12_000,
        description="Motor speed limit; at most limits.speed_limit_max_rpm, which is also the"
        " default where that is lower.",
    )
    power_limit_w: int = Field(
        default=60_000,
        ge=0,
        le=60_000,
        description="Motor power limit; at most limits.power_limit_max_w, which is also the"
        " default where that is lower.",
    )


class BenchSection(Section):
    """For a test bench only; a vehicle has no such section."""

    demand: BenchDemandSection | None = Field(
        default=None, description="Static demand for both controllers; null is none."
    )
    auto_arm: bool = Field(
        default=False, description="Arm once by itself, as soon as everything is healthy."
    )
