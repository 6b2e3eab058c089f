"""What the gateway lets the vehicle do, and what the vehicle says."""

from collections.abc import Callable, Mapping

from vcu_gateway.core.causes import Effect, HeldCause
from vcu_gateway.core.commands import Command
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.core.why import Explanation
from vcu_gateway.exporter.family import Family, Instant, Samples, by, gauge, one, states

_PCT = 100


def _ticked(read: Callable[[Instant, Explanation], Samples]) -> Callable[[Instant], Samples]:
    """What the last tick knew; nothing before the first."""
    return lambda at: {} if at.latest is None else read(at, at.latest.why)


def _held(why: Explanation) -> tuple[HeldCause, ...]:
    """Everything that counted."""
    return why.blocks + why.limits + why.alarms


def _causes(at: Instant, why: Explanation) -> Samples:
    found = [(held.finding, at.since_s(held.since_ns)) for held in _held(why)]
    return {
        (finding.cause, finding.subject, finding.effect.value): since_s
        for finding, since_s in found
    }


def _demand_age(at: Instant, why: Explanation) -> Samples:
    age_ns = why.demand_age_ns
    return one(None if age_ns is None else at.since_s(why.now_ns - age_ns))


def _asked(at: Instant, value: Callable[[ControllerDemand], float]) -> Samples:
    """What the demand asks of each controller; nothing where none counts."""
    demand = at.gateway.requests.desk.current
    if demand is None or at.latest is None or not at.latest.why.demand_fresh:
        return {}
    return by({name: value(asked) for name, asked in demand.controllers.items()})


def _told(at: Instant) -> Mapping[str, Command]:
    """What each controller was told in the last tick; nothing where that tick sent nothing."""
    if at.latest is None:
        return {}
    result = at.latest.result
    return {frame.controller: result.commands[frame.controller] for frame in result.frames}


def _command(name: str, text: str, value: Callable[[Command], float]) -> Family:
    """A value of the last command frame of each controller."""
    return gauge(
        f"command_{name}",
        f"{text} in the last tick; absent where it sent nothing.",
        lambda at: by({controller: value(told) for controller, told in _told(at).items()}),
        "controller",
    )


def _power_modes(at: Instant) -> Samples:
    return {
        (controller, mode.name.lower()): float(told.power_mode is mode)
        for controller, told in _told(at).items()
        for mode in PowerMode
    }


def _signals(at: Instant) -> Samples:
    return {
        (spec.name, reading.name, reading.unit): reading.good_value
        for spec in at.snapshot.messages
        for reading in at.snapshot.readings(spec.name)
        if reading.good_value is not None
    }


FAMILIES: tuple[Family, ...] = (
    gauge(
        "mode",
        "1 for the mode of the last tick, 0 for the others.",
        _ticked(lambda _, why: states(Mode, [why.mode])),
        "mode",
    ),
    gauge(
        "fault_latched",
        "1 where a fault is latched, by the level of the reset that it needs.",
        _ticked(lambda _, why: states(FaultClass, [why.latch.fault_class] if why.latch else [])),
        "fault_class",
    ),
    gauge(
        "effect",
        "1 for each effect that counted in the last tick, 0 for the others.",
        _ticked(lambda _, why: states(Effect, [held.finding.effect for held in _held(why)])),
        "effect",
    ),
    gauge(
        "cause_seconds",
        "How long each cause with its effect has counted; absent where it does not count.",
        _ticked(_causes),
        "cause",
        "subject",
        "effect",
    ),
    gauge(
        "demand_fresh",
        "1 where a demand counted in the last tick, else 0.",
        _ticked(lambda _, why: one(float(why.demand_fresh))),
    ),
    gauge(
        "demand_age_seconds",
        "Age of the latest demand; absent without one and for the bench demand.",
        _ticked(_demand_age),
    ),
    gauge(
        "demand_throttle_ratio",
        "Throttle that the demand asks for, 0 to 1; absent where none counted.",
        lambda at: _asked(at, lambda asked: asked.throttle_pct / _PCT),
        "controller",
    ),
    gauge(
        "demand_brake_ratio",
        "Brake that the demand asks for, 0 to 1; absent where none counted.",
        lambda at: _asked(at, lambda asked: asked.brake_pct / _PCT),
        "controller",
    ),
    _command(
        "throttle_ratio", "Commanded throttle, 0 to 1,", lambda told: told.throttle_pct / _PCT
    ),
    _command("brake_ratio", "Commanded brake, 0 to 1,", lambda told: told.brake_pct / _PCT),
    _command("speed_limit_rpm", "Commanded speed limit", lambda told: told.speed_limit_rpm),
    _command("power_limit_watts", "Commanded power limit", lambda told: told.power_limit_w),
    _command("motor_reverse", "1 where reverse was commanded", lambda told: told.motor_reverse),
    _command("regen_brake", "1 where regeneration was commanded", lambda told: told.regen_brake),
    _command("power_cut", "1 where the power was cut", lambda told: told.power_cut),
    gauge(
        "command_power_mode",
        "1 for the power mode commanded in the last tick; absent where it sent nothing.",
        _power_modes,
        "controller",
        "power_mode",
    ),
    gauge(
        "limit_speed_rpm",
        "Configured maximum of the speed limit.",
        lambda at: one(at.gateway.settings.speed_limit_max_rpm),
    ),
    gauge(
        "limit_power_watts",
        "Configured maximum of the power limit.",
        lambda at: one(at.gateway.settings.power_limit_max_w),
    ),
    gauge(
        "limit_derated_power_watts",
        "Configured power limit under the effect `power limit`.",
        lambda at: one(at.gateway.settings.derated_power_w),
    ),
    gauge(
        "limit_regen_ratio",
        "Configured brake under the effect `regen limit`, 0 to 1.",
        lambda at: one(at.gateway.settings.regen_limit_pct / _PCT),
    ),
    gauge(
        "signal",
        "Received signals in the protocol's units, codes as numbers;"
        " absent unless fresh and in range.",
        _signals,
        "message",
        "signal",
        "unit",
    ),
)
"""Everything that tells of the vehicle."""
