"""Sections about the vehicle: limits, safety, demand and the test bench.

Their keys come from `core.settings`, but for the bench demand's.
"""

from typing import Literal

from pydantic import Field, field_validator

from vcu_gateway.config.settings_section import SettingsSection, with_settings
from vcu_gateway.config.value_types import Confirmation
from vcu_gateway.core.settings import REQUIRED_MESSAGES
from vcu_gateway.demand_ranges import POWER_LIMIT_HIGHEST_W, SPEED_LIMIT_HIGHEST_RPM
from vcu_gateway.strict_yaml.section import Section, refusal


@with_settings("limits")
class LimitsSection(SettingsSection):
    """Limits of every command, whoever asks."""


@with_settings("safety")
class SafetySection(SettingsSection):
    """When the vehicle may move."""

    @field_validator("required_messages", check_fields=False)
    @classmethod
    def _keeps_the_defaults(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        if any(name not in names for name in REQUIRED_MESSAGES):
            defaults = ", ".join(REQUIRED_MESSAGES)
            what = f"must hold {defaults}, without which nothing ever moves"
            raise refusal(what, f"write [{defaults}], and others after them")
        return names


@with_settings("demand")
class DemandSection(SettingsSection):
    """Demands for torque: their owners, and for how long one counts."""


class BenchDemandSection(Section):
    """A demand that never ends, for both controllers, without a driver."""

    bench_use_only: Confirmation = Field(
        description="Must be true: it confirms that the wheels are off the ground.",
        json_schema_extra={"const": True},
        examples=[True],
    )
    throttle_pct: float = Field(default=0.0, ge=0, le=100, description="Throttle pedal.")
    brake_pct: float = Field(default=0.0, ge=0, le=100, description="Brake pedal.")
    power_mode: Literal["eco", "normal", "turbo", "safety"] = Field(
        default="eco", description="The controllers' power mode."
    )
    motor_reverse: bool = Field(default=False, description="Turn the motors in reverse.")
    regen_brake: bool = Field(default=False, description="Recover energy while braking.")
    speed_limit_rpm: int = Field(
        default=SPEED_LIMIT_HIGHEST_RPM,
        ge=0,
        le=SPEED_LIMIT_HIGHEST_RPM,
        description="Motor speed limit; at most limits.speed_limit_max_rpm, which is also the"
        " default where that is lower.",
    )
    power_limit_w: int = Field(
        default=POWER_LIMIT_HIGHEST_W,
        ge=0,
        le=POWER_LIMIT_HIGHEST_W,
        description="Motor power limit; at most limits.power_limit_max_w, or 60000, which sets"
        " no limit of its own.",
    )


@with_settings("bench")
class BenchSection(SettingsSection):
    """FOR A TEST BENCH ONLY, WITH THE WHEELS OFF THE GROUND.

    Nobody holds the pedal, and the demand never ends. A vehicle's file leaves all of this out.
    """

    demand: BenchDemandSection | None = Field(
        default=None,
        description="Static demand for both motor controllers; without this key there is none.",
    )
