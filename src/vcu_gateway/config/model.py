"""Every key of the configuration: its unit, default and range, each written once.

The last word of a number's name is its unit. The ranges, defaults and descriptions here are
what `vcu-gateway schema` prints; a test holds config/gateway.yaml to them.
"""

import ipaddress
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from pydantic import Field, PrivateAttr, ValidationInfo, field_validator

from vcu_gateway.config.kinds import (
    AgeMs,
    Confirmation,
    File,
    Identifier,
    MessageName,
    Priority,
    Section,
    SourceName,
    StatusCode,
    refusal,
)
from vcu_gateway.core.settings import REQUIRED_MESSAGES
from vcu_gateway.protocol import DEFAULT_ALIASES
from vcu_gateway.yaml_lines import LineMap

_INTERFACE_NAME = re.compile(r"[^\s/:]{1,15}")


class Bus(Section):
    """The CAN bus and how it is read."""

    interface: Literal["socketcan", "virtual", "udp_multicast"] = Field(
        default="socketcan",
        description="Kind of bus; virtual exists inside one process, for tests.",
    )
    channel: str = Field(
        default="can0",
        description="Which bus: a network interface, or for udp_multicast a multicast address.",
    )
    bit_rate_bit_s: int = Field(
        default=250_000,
        ge=10_000,
        le=1_000_000,
        description="What the interface is expected to run at; the system sets it, not the"
        " gateway.",
    )
    kernel_filters: bool = Field(
        default=True, description="Let the kernel drop frames that nobody here decodes."
    )
    gather_ms: float = Field(
        default=17.0,
        ge=0,
        le=18,
        description="How long received frames may gather before one wake-up handles them all;"
        " shortly before every tick they are read in any case.",
    )
    receive_buffer_bytes: int | None = Field(
        default=None,
        ge=4096,
        le=16_777_216,
        description="The socket's receive buffer; null leaves it as the kernel has it.",
    )
    reopen_ms: int = Field(
        default=200,
        ge=50,
        le=1000,
        description="Pause between attempts to reopen a lost interface.",
    )

    @field_validator("channel")
    @classmethod
    def _channel_of_interface(cls, channel: str, info: ValidationInfo) -> str:
        interface = info.data.get("interface")
        if interface == "udp_multicast" and not _is_multicast(channel):
            raise refusal("must be a multicast address for udp_multicast", "such as 239.74.163.2")
        if interface == "socketcan" and not _INTERFACE_NAME.fullmatch(channel):
            raise refusal("must be the name of a network interface", "such as can0")
        if not channel:
            raise refusal("must be a name")
        return channel


def _is_multicast(channel: str) -> bool:
    try:
        return ipaddress.ip_address(channel).is_multicast
    except ValueError:
        return False


class Protocol(Section):
    """What travels on the bus."""

    dbc: File | None = Field(
        default=None,
        description="DBC file, relative to the configuration file; null is the packaged one.",
    )
    aliases: Mapping[Identifier, MessageName] = Field(
        default=dict(DEFAULT_ALIASES),
        description="Further identifiers (29 bits) that are received as a message (errata E3);"
        " {} for none.",
    )
    transmit_priority: int = Field(
        default=0,
        ge=0,
        le=7,
        description="J1939 priority of the command frames, 0 wins over all others (errata E1).",
    )
    status_code_names: Mapping[StatusCode, str] = Field(
        default={},
        description="Names of the motor controllers' StatusCode (0..65535), from their vendor.",
    )


class Freshness(Section):
    """When a message is too old, where the period in the protocol does not say it well."""

    stale_after_ms: Mapping[MessageName, AgeMs] = Field(
        default={},
        description="Age by message name, 1..60000 ms, from which a message counts as missing.",
    )
    late_after_ms: Mapping[MessageName, AgeMs] = Field(
        default={},
        description="Age by message name, 1..60000 ms, from which a message counts as late.",
    )


class Limits(Section):
    """What a command never exceeds, whoever asks."""

    speed_limit_max_rpm: int = Field(
        default=12_000,
        ge=0,
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
    direction_change_rpm: float = Field(
        default=50.0,
        ge=0,
        le=100,
        description="The direction changes only while both motors turn slower than this.",
    )


class Safety(Section):
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

    @field_validator("required_messages")
    @classmethod
    def _keeps_the_defaults(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        missing = [name for name in REQUIRED_MESSAGES if name not in names]
        if missing:
            raise refusal(f"must name {', '.join(REQUIRED_MESSAGES)}", f"add {missing[0]}")
        return names


class Demand(Section):
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
        description="Time to live of a demand that carries none.",
    )
    priorities: Mapping[SourceName, Priority] = Field(
        default={},
        description="Priority by source, 0..100; a source that is not listed has 0, the higher"
        " takes over from the lower.",
    )


class BenchDemand(Section):
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


class Bench(Section):
    """For a test bench only; a vehicle has no such section."""

    demand: BenchDemand | None = Field(
        default=None, description="Static demand for both controllers; null is none."
    )
    auto_arm: bool = Field(
        default=False, description="Arm once by itself, as soon as everything is healthy."
    )


class Log(Section):
    """What is written to stderr, and so to the journal."""

    level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="The least severe event that is written."
    )
    format: Literal["auto", "json", "console"] = Field(
        default="auto", description="auto is console on a terminal, else json, a line an event."
    )


@dataclass(frozen=True)
class Source:
    """The file that a configuration came from; two files that say the same are equal."""

    file: str = field(default="", compare=False)
    lines: LineMap = field(default_factory=LineMap, compare=False)


class Config(Section):
    """Configuration of vcu-gateway."""

    bus: Bus = Bus()
    protocol: Protocol = Protocol()
    freshness: Freshness = Freshness()
    limits: Limits = Limits()
    safety: Safety = Safety()
    demand: Demand = Demand()
    bench: Bench = Bench()
    log: Log = Log()

    _source: Source = PrivateAttr(default_factory=Source)

    @property
    def source(self) -> Source:
        """Where this configuration was read; an empty file name where it was not."""
        return self._source

    def remember_source(self, source: Source) -> None:
        """Keep where this was read, for errors that show later."""
        self._source = source
