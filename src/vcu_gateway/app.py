"""Configuration -> gateway, bus and tick loop, put together; `serving` adds the API."""

import dataclasses
import time
from pathlib import Path

from vcu_gateway.bus.connection import BusConnection, BusSettings
from vcu_gateway.config import BenchDemandSection, Config
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.daemon.loop import Observer, TickLoop
from vcu_gateway.errors import DataError, Problem
from vcu_gateway.protocol import compatibility, dbc, packaged

_MOST_DIFFERENCES = 20


def load_protocol(config: Config) -> ProtocolSpec:
    """The configured DBC, or the packaged one, with the configured aliases."""
    return dataclasses.replace(dbc.load(dbc_path(config)), aliases=config.protocol.aliases)


def dbc_path(config: Config) -> Path:
    """The DBC in use."""
    return packaged("vcu.dbc") if config.protocol.dbc is None else config.protocol.dbc


def check_protocol(config: Config, protocol: ProtocolSpec) -> None:
    """DataError where a DBC contradicts the protocol that the safety rules were written for."""
    if config.protocol.dbc is None:
        return
    found = list(compatibility.differences(protocol, dbc.load(packaged("vcu.dbc"))))
    if found:
        remedy = "the safety rules are written for dbc/vcu.yaml; change it, and the rules with it"
        where = str(config.protocol.dbc)
        raise DataError(*[Problem(what, where, remedy) for what in found[:_MOST_DIFFERENCES]])


def build(config: Config, protocol: ProtocolSpec, observer: Observer | None = None) -> TickLoop:
    """Gateway, bus door and tick loop of this configuration; the bus is not opened yet."""
    codec = Codec(protocol)
    gateway = Gateway(codec, settings(config), time.monotonic_ns())
    intake = gateway.intake
    door = BusConnection(
        bus_settings(config), codec.identifiers(), intake.receive, intake.command_groups
    )
    return TickLoop(gateway, door, reopen_ms=config.bus.reopen_ms, observer=observer)


def settings(config: Config) -> Settings:
    """What the core is told."""
    limits, safety, demand = config.limits, config.safety, config.bench.demand
    return Settings(
        late_after_ms=config.freshness.late_after_ms,
        stale_after_ms=config.freshness.stale_after_ms,
        transmit_priority=config.protocol.transmit_priority,
        required=safety.required_messages,
        listen_before_talk_ms=safety.listen_before_talk_ms,
        qualify_frames=safety.qualify_frames,
        clear_hold_ms=safety.clear_hold_ms,
        speed_limit_max_rpm=limits.speed_limit_max_rpm,
        power_limit_max_w=limits.power_limit_max_w,
        derated_power_w=limits.derated_power_w,
        regen_limit_pct=limits.regen_limit_pct,
        throttle_slew_pct_per_s=limits.throttle_slew_pct_per_s,
        power_slew_w_per_s=limits.power_slew_w_per_s,
        regen_slew_pct_per_s=limits.regen_slew_pct_per_s,
        speed_slew_rpm_per_s=limits.speed_slew_rpm_per_s,
        direction_change_rpm=limits.direction_change_rpm,
        regen_min_rpm=limits.regen_min_rpm,
        echo_below_max_pct=safety.echo_below_max_pct,
        motor_speed_step_max_rpm=safety.motor_speed_step_max_rpm,
        wheel_speed_step_max_kmh=safety.wheel_speed_step_max_kmh,
        wheel_speed_difference_max_kmh=safety.wheel_speed_difference_max_kmh,
        ttl_max_ms=config.demand.ttl_max_ms,
        ttl_default_ms=config.demand.ttl_default_ms,
        priorities=config.demand.priorities,
        independent_directions=config.demand.independent_directions,
        second_track_required=config.demand.second_track_required,
        bench_demand=None if demand is None else _bench_demand(demand),
        auto_arm=config.bench.auto_arm,
    )


def bus_settings(config: Config) -> BusSettings:
    """What the bus door is told."""
    bus = config.bus
    return BusSettings(
        interface=bus.interface,
        channel=bus.channel,
        kernel_filters=bus.kernel_filters,
        gather_s=bus.gather_ms / 1000,
        receive_buffer_bytes=bus.receive_buffer_bytes,
        bit_rate_bit_s=bus.bit_rate_bit_s,
    )


def _bench_demand(demand: BenchDemandSection) -> ControllerDemand:
    return ControllerDemand(
        throttle_pct=demand.throttle_pct,
        brake_pct=demand.brake_pct,
        power_mode=PowerMode[demand.power_mode.upper()],
        motor_reverse=demand.motor_reverse,
        regen_brake=demand.regen_brake,
        speed_limit_rpm=demand.speed_limit_rpm,
        power_limit_w=demand.power_limit_w,
    )
