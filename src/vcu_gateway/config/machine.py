"""Sections about the machine: bus, protocol, freshness, API and log."""

import ipaddress
import re
from collections.abc import Mapping
from typing import Literal

from pydantic import Field, ValidationInfo, field_validator

from vcu_gateway.config.value_types import (
    AgeMs,
    File,
    FileMode,
    Identifier,
    MessageName,
    Section,
    SocketPath,
    StatusCode,
    UserName,
    refusal,
)
from vcu_gateway.protocol import DEFAULT_ALIASES

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
        description="The socket's receive buffer; null leaves it as the kernel has it. A warning"
        " tells where the kernel gives less.",
    )
    reopen_ms: int = Field(
        default=200,
        ge=50,
        le=1000,
        description="First pause before an interface that keeps failing is opened again; it"
        " doubles up to 800 ms.",
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
        description="Age by message name, 1..60000 ms, from which a message counts as missing;"
        " for a required message at most twice its default.",
    )
    late_after_ms: Mapping[MessageName, AgeMs] = Field(
        default={},
        description="Age by message name, 1..60000 ms, from which a message counts as late;"
        " for a required message at most twice its default.",
    )


class Api(Section):
    """The local API: who may use it, and where."""

    enabled: bool = Field(default=True, description="Offer the API on a Unix socket.")
    socket_path: SocketPath = Field(
        default="/run/vcu-gateway/control.sock",
        description="The Unix socket, an absolute path of at most 107 bytes; its folder exists.",
    )
    socket_owner: UserName | None = Field(
        default=None, description="User who owns the socket; null is the gateway's own."
    )
    socket_group: UserName | None = Field(
        default=None,
        description="Group of the socket; with the mode it says who may read the state, and"
        " stop the vehicle. null is the gateway's own.",
    )
    socket_mode: FileMode = Field(
        default="0660", description="Permissions of the socket, octal digits in quotes."
    )
    operator_users: tuple[UserName, ...] = Field(
        default=(),
        strict=False,
        description="Users who may also demand, arm and reset at driver level; the gateway's own"
        " user and root always may.",
    )
    operator_groups: tuple[UserName, ...] = Field(
        default=(), strict=False, description="Groups that may do the same."
    )
    service_users: tuple[UserName, ...] = Field(
        default=(),
        strict=False,
        description="Users who may also reset at service level and reload the configuration.",
    )
    service_groups: tuple[UserName, ...] = Field(
        default=(), strict=False, description="Groups that may do the same."
    )
    metrics_port: int | None = Field(
        default=None,
        ge=1024,
        le=65_535,
        description="Also serve the metrics on this TCP port of 127.0.0.1; null is the socket"
        " alone.",
    )


class Log(Section):
    """What is written to stderr, and so to the journal."""

    level: Literal["debug", "info", "warning", "error"] = Field(
        default="info", description="The least severe event that is written."
    )
    format: Literal["auto", "json", "console"] = Field(
        default="auto", description="auto is console on a terminal, else json, a line an event."
    )
