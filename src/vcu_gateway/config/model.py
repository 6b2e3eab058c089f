"""The whole configuration: sections about the vehicle and about the gateway itself.

Unit, range, default and text of a key stand once: those of the vehicle in `core.settings`, those of
the bench demand, the bus, API and log here. `vcu-gateway schema` and config/gateway.yaml are made
from both.
"""

import ipaddress
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Literal

from pydantic import Field, PrivateAttr, ValidationInfo, field_validator

from vcu_gateway.config.pedals import PedalsSection
from vcu_gateway.config.tuning import CurvesSection, DriveModesSection, LawsSection, VehicleSection
from vcu_gateway.config.value_types import (
    Confirmation,
    File,
    FileMode,
    Identifier,
    SettingsSection,
    SocketPath,
    StatusCode,
    UserName,
    UserNames,
    with_settings,
)
from vcu_gateway.core.settings import REQUIRED_MESSAGES, MessageName
from vcu_gateway.demand_ranges import POWER_LIMIT_HIGHEST_W, SPEED_LIMIT_HIGHEST_RPM
from vcu_gateway.protocol import DEFAULT_ALIASES
from vcu_gateway.strict_yaml.file_text import LineMap
from vcu_gateway.strict_yaml.validation import Section, refusal


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


@dataclass(frozen=True)
class ConfigSource:
    """The file that a configuration came from; two files that say the same are equal."""

    file: str = field(default="", compare=False)
    lines: LineMap = field(default_factory=LineMap, compare=False)


IDENTIFIER_KEYS = ("protocol", "aliases")
"""The mapping whose keys are identifiers: problems show them in hexadecimal."""

_INTERFACE_NAME = re.compile(r"[^\s/:]+")
_INTERFACE_BYTES = 15


class BusSection(Section):
    """The CAN bus and how it is read."""

    removed: ClassVar[Mapping[str, str]] = {
        "gather_ms": "remove it: the bus is read before every tick"
    }

    interface: Literal["socketcan", "virtual", "udp_multicast"] = Field(
        default="socketcan",
        description="Kind of bus; virtual exists inside one process, for tests.",
    )
    channel: str = Field(
        default="can0",
        description="Which bus: a network interface, or for udp_multicast a multicast address"
        " (239.74.163.2).",
    )
    bit_rate_bit_s: int = Field(
        default=250_000,
        ge=10_000,
        le=1_000_000,
        description="What the interface is expected to run at. The system sets it, not the gateway;"
        " the vehicle's documents do not state it, 250 kbit/s is J1939's.",
    )
    kernel_filters: bool = Field(
        default=True,
        description="Let the kernel drop frames that nobody here decodes. Off, they are counted as"
        " unknown.",
    )
    receive_buffer_bytes: int | None = Field(
        default=None,
        ge=4096,
        le=16_777_216,
        description="The socket's receive buffer; without this key enough is asked for to hold some"
        " ticks of a full bus. With it, a warning tells where the kernel gives less"
        " (net.core.rmem_max limits it).",
        examples=[1_048_576],
    )
    reopen_ms: int = Field(
        default=200,
        ge=50,
        le=1000,
        description="First pause before an interface that keeps failing is opened again; it"
        " doubles up to 800 ms. One that was steady is opened again as soon as it is seen.",
    )

    @field_validator("channel")
    @classmethod
    def _channel_of_interface(cls, channel: str, info: ValidationInfo) -> str:
        interface = info.data.get("interface")
        if interface == "udp_multicast" and not _is_multicast(channel):
            raise refusal("must be a multicast address for udp_multicast", "such as 239.74.163.2")
        if interface == "socketcan" and not _is_interface_name(channel):
            raise refusal("must be the name of a network interface", "such as can0")
        if not channel:
            raise refusal("must be a name")
        return channel


def _is_interface_name(channel: str) -> bool:
    """As the kernel has it: 15 bytes, no slash, colon or white space."""
    fits = len(channel.encode(errors="surrogateescape")) <= _INTERFACE_BYTES
    return fits and channel not in (".", "..") and bool(_INTERFACE_NAME.fullmatch(channel))


def _is_multicast(channel: str) -> bool:
    try:
        return ipaddress.ip_address(channel).is_multicast
    except ValueError:
        return False


@with_settings("protocol")
class ProtocolSection(SettingsSection):
    """Messages on the bus: their DBC, aliases and priority."""

    dbc: File | None = Field(
        default=None,
        description="DBC file, relative to this file; without this key it is the packaged one.",
        examples=["vcu.dbc"],
    )
    aliases: Mapping[Identifier, MessageName] = Field(
        default=dict(DEFAULT_ALIASES),
        description="Further identifiers that are received as a message: the vehicle's documents"
        " print a second one beside the IMU's attitude (errata E3). {} is none.",
    )
    status_code_names: Mapping[StatusCode, str] = Field(
        default={},
        description="Names of the motor controllers' StatusCode, as in {3: overvoltage}; from"
        " their vendor.",
    )


@with_settings("freshness")
class FreshnessSection(SettingsSection):
    """When a message is too old, where its period in the protocol does not say it well."""


class ApiSection(Section):
    """The local API for operators and other programs: docs/api.md."""

    removed: ClassVar[Mapping[str, str]] = {
        "metrics_port": "remove it: the metrics are served by a program of their own,"
        " vcu-gateway-exporter.service or `vcu-gateway exporter`"
    }

    enabled: bool = Field(
        default=True,
        description="Offer the API on a Unix socket. Without it only a bench demand can drive.",
    )
    socket_path: SocketPath = Field(
        default="/run/vcu-gateway/control.sock",
        description="The Unix socket, an absolute path of at most 107 bytes; its folder exists.",
    )
    socket_owner: UserName | None = Field(
        default=None,
        description="User who owns the socket, by name or number; without this key it is the"
        " gateway's own. The installed service may not give files away: leave this key and the"
        " next out there.",
        examples=["vcu-gateway"],
    )
    socket_group: UserName | None = Field(
        default=None,
        description="Group of the socket. With the mode it says who may read the state, and stop"
        " the vehicle (estop, disarm); without this key it is the gateway's own.",
        examples=["vcu-gateway"],
    )
    socket_mode: FileMode = Field(
        default="0660", description="Permissions of the socket, three octal digits."
    )
    operator_users: UserNames = Field(
        default=(),
        description="Users who may also demand, arm and reset at driver level, by name or number."
        " The gateway's own user and root always may.",
    )
    operator_groups: UserNames = Field(default=(), description="Groups that may do the same.")
    service_users: UserNames = Field(
        default=(),
        description="Users who may also reset at service level and reload the configuration.",
    )
    service_groups: UserNames = Field(default=(), description="Groups that may do the same.")


class RecorderSection(Section):
    """What the recorder, a program of its own, is handed: docs/recordings.md."""

    socket_path: SocketPath | None = Field(
        default="/run/vcu-gateway-recorder/tap.sock",
        description="The recorder's Unix socket, an absolute path of at most 107 bytes. It is"
        " looked for once a second, and nothing waits for it; null hands nothing on.",
    )


class LogSection(Section):
    """The log, on stderr, and so in the journal."""

    level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="The least severe event that is written."
    )
    format: Literal["auto", "json", "console"] = Field(
        default="auto",
        description="console is for a person, json for machines, a line an event; auto is console"
        " on a terminal, else json.",
    )


class Config(Section):
    """Configuration of vcu-gateway."""

    outline: ClassVar[str] = "must hold sections such as `bus:`"

    bus: BusSection = BusSection()
    protocol: ProtocolSection = ProtocolSection()
    freshness: FreshnessSection = FreshnessSection()
    vehicle: VehicleSection = VehicleSection()
    limits: LimitsSection = LimitsSection()
    curves: CurvesSection = CurvesSection()
    drive_modes: DriveModesSection = DriveModesSection()
    laws: LawsSection = LawsSection()
    safety: SafetySection = SafetySection()
    demand: DemandSection = DemandSection()
    pedals: PedalsSection = PedalsSection()
    api: ApiSection = ApiSection()
    recorder: RecorderSection = RecorderSection()
    bench: BenchSection = BenchSection()
    log: LogSection = LogSection()

    _source: ConfigSource = PrivateAttr(default_factory=ConfigSource)

    @property
    def source(self) -> ConfigSource:
        """Where this configuration was read; an empty file name where it was not."""
        return self._source

    def remember_source(self, source: ConfigSource) -> None:
        """Keep where this was read, for errors that show later."""
        self._source = source
