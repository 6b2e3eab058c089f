"""Limits, times and lists of the core: each one's default, range, text and reload rule, once.

A field of `Settings` is a key of the configuration file. Its annotation holds what the file may
say, `Key` the section that it stands in, when a changed value is taken, and the text for people.
The configuration's sections, its JSON Schema, config/gateway.yaml and the rules of a reload are
made from these fields. The last word of a number's name is its unit.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import Enum
from typing import Annotated, get_type_hints

from annotated_types import Interval, Len, MinLen

from vcu_gateway.core import tuning as tuning_module
from vcu_gateway.core.can_pedals import CanPedals
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.tuning import Tuning
from vcu_gateway.demand_ranges import POWER_LIMIT_HIGHEST_W, SPEED_LIMIT_HIGHEST_RPM

REQUIRED_MESSAGES = ("BMS_Status", "PCU1_Status2", "PCU2_Status2")
"""Messages that are always required; the configuration may add others."""

MessageName = Annotated[str, MinLen(1)]
SourceName = Annotated[str, Len(1, 64)]
AgeMs = Annotated[int, Interval(ge=1, le=60_000)]
Priority = Annotated[int, Interval(ge=0, le=100)]


class Reload(Enum):
    """When a running gateway takes a changed value."""

    NEVER = "at the next start"
    LIVE = "live, but not while active"
    SMALLER = "live, while active only a smaller value"
    LARGER = "live, while active only a larger value"


@dataclass(frozen=True, slots=True)
class Key:
    """Key of the configuration file; its name is that of the field.

    Attributes:
        section: the section of the file that it stands in.
        reload: when a changed value is taken.
        text: what it means, for the schema and for config/gateway.yaml.
        below: key of the same section at and above which it has no effect; None without one.
    """

    section: str
    reload: Reload
    text: str
    below: str | None = None


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of the core; every default is that of docs/safety.md.

    Attributes:
        period_ns: of the command frames; in no file.
        tuning: curves, drive modes and laws; their keys are those of core/tuning.py.
        pedals: pedals on CAN; None without them.
        bench_demand: static demand for both controllers on a test bench; None on a vehicle.
    """

    stale_after_ms: Annotated[
        Mapping[MessageName, AgeMs],
        Key(
            "freshness",
            Reload.NEVER,
            "Age by message name from which a message counts as missing, as in {IMU_Attitude: 250}."
            " Without an entry: 3.2 periods of 500 ms, 3 of 100 ms, 4 of 50 ms, 10 of 10 ms."
            " For one of safety.required_messages at most twice that.",
        ),
    ] = field(default_factory=dict)
    late_after_ms: Annotated[
        Mapping[MessageName, AgeMs],
        Key(
            "freshness",
            Reload.NEVER,
            "Age by message name from which a message counts as late. Without an entry: 2.2"
            " periods. For one of safety.required_messages at most twice that.",
        ),
    ] = field(default_factory=dict)
    transmit_priority: Annotated[
        int,
        Interval(ge=0, le=7),
        Key(
            "protocol",
            Reload.NEVER,
            "J1939 priority of the command frames; 0 wins over all others (errata E1).",
        ),
    ] = 0
    period_ns: int = 50_000_000

    speed_limit_max_rpm: Annotated[
        int,
        Interval(ge=500, le=SPEED_LIMIT_HIGHEST_RPM),
        Key(
            "limits",
            Reload.SMALLER,
            "Largest SpeedLimit that is ever sent to a motor controller.",
        ),
    ] = SPEED_LIMIT_HIGHEST_RPM
    power_limit_max_w: Annotated[
        int,
        Interval(ge=0, le=POWER_LIMIT_HIGHEST_W),
        Key(
            "limits",
            Reload.SMALLER,
            "Largest PowerLimit that is ever sent to a motor controller.",
        ),
    ] = POWER_LIMIT_HIGHEST_W
    derated_power_w: Annotated[
        int,
        Interval(ge=0, le=30_000),
        Key(
            "limits",
            Reload.SMALLER,
            "PowerLimit while a cause limits the power (the battery is low, a controller protects"
            " itself). It has an effect below limits.power_limit_max_w only.",
            below="power_limit_max_w",
        ),
    ] = 10_000
    regen_limit_pct: Annotated[
        float,
        Interval(ge=0, le=50),
        Key(
            "limits",
            Reload.SMALLER,
            "Brake while a cause limits regeneration (the battery is full).",
        ),
    ] = 20.0
    throttle_slew_pct_per_s: Annotated[
        float,
        Interval(ge=10, le=200),
        Key("limits", Reload.SMALLER, "Steepest rise of the throttle; it falls at once."),
    ] = 100.0
    power_slew_w_per_s: Annotated[
        float,
        Interval(ge=6_000, le=120_000),
        Key(
            "limits",
            Reload.LIVE,
            "How fast a power limit comes and goes: a sudden one throws riders.",
        ),
    ] = 60_000.0
    regen_slew_pct_per_s: Annotated[
        float,
        Interval(ge=10, le=200),
        Key("limits", Reload.LIVE, "How fast a regeneration limit comes and goes."),
    ] = 100.0
    speed_slew_rpm_per_s: Annotated[
        float,
        Interval(ge=500, le=20_000),
        Key(
            "limits",
            Reload.LIVE,
            "Steepest fall of the SpeedLimit, which is never below 500 rpm; it rises at once."
            " A sudden limit could brake hard.",
        ),
    ] = 4_000.0
    power_return_w_per_s: Annotated[
        float,
        Interval(ge=100, le=60_000),
        Key("limits", Reload.LIVE, "How fast a power limit of a curve or a drive mode returns."),
    ] = 1_000.0
    brake_return_pct_per_s: Annotated[
        float,
        Interval(ge=1, le=100),
        Key("limits", Reload.LIVE, "How fast a brake limit of a curve or a drive mode returns."),
    ] = 20.0
    speed_fall_rpm_per_s: Annotated[
        float,
        Interval(ge=100, le=4_000),
        Key(
            "limits",
            Reload.LIVE,
            "Steepest fall of the SpeedLimit because of a curve or a drive mode: a controller may"
            " brake to hold it.",
        ),
    ] = 500.0
    speed_return_rpm_per_s: Annotated[
        float,
        Interval(ge=100, le=20_000),
        Key("limits", Reload.LIVE, "How fast a speed limit of a curve or a drive mode returns."),
    ] = 1_000.0
    direction_change_rpm: Annotated[
        float,
        Interval(ge=0, le=100),
        Key(
            "limits",
            Reload.SMALLER,
            "The direction changes only while both motors turn slower than this.",
        ),
    ] = 50.0
    regen_min_rpm: Annotated[
        float,
        Interval(ge=0, le=1_000),
        Key(
            "limits",
            Reload.LARGER,
            "Both motors turn at least this fast for regeneration; it returns 50 rpm above."
            " 0 switches this off.",
        ),
    ] = 100.0

    required_messages: Annotated[
        tuple[MessageName, ...],
        Key(
            "safety",
            Reload.LIVE,
            "Messages without which nothing moves. The list must hold the three defaults; others"
            " may be added.",
        ),
    ] = REQUIRED_MESSAGES
    listen_before_talk_ms: Annotated[
        int,
        Interval(ge=1_000, le=10_000),
        Key(
            "safety",
            Reload.NEVER,
            "Silence at the start, to hear another sender of the command frames before talking.",
        ),
    ] = 1_000
    qualify_frames: Annotated[
        int,
        Interval(ge=3, le=100),
        Key(
            "safety",
            Reload.LIVE,
            "Good frames of each required message before the vehicle may be armed.",
        ),
    ] = 3
    clear_hold_ms: Annotated[
        int,
        Interval(ge=1_000, le=60_000),
        Key(
            "safety",
            Reload.LARGER,
            "How long a cause must be gone before its effect ends, or a fault can be reset.",
        ),
    ] = 1_000
    echo_below_max_pct: Annotated[
        float,
        Interval(ge=5, le=50),
        Key(
            "safety",
            Reload.NEVER,
            "Throttle that a controller may echo below the lowest commanded in the second before,"
            " until it counts as not obeying.",
        ),
    ] = 15.0
    motor_speed_step_max_rpm: Annotated[
        float,
        Interval(ge=500, le=12_000),
        Key(
            "safety",
            Reload.NEVER,
            "Largest change of a motor's speed between two frames that is believed; after a larger"
            " one the speed is unknown until three plausible ones in a row.",
        ),
    ] = 2_000.0
    wheel_speed_step_max_kmh: Annotated[
        float,
        Interval(ge=5, le=200),
        Key(
            "safety",
            Reload.NEVER,
            "Largest change of a wheel's speed between two frames that raises no alarm.",
        ),
    ] = 20.0
    wheel_speed_difference_max_kmh: Annotated[
        float,
        Interval(ge=1, le=200),
        Key(
            "safety",
            Reload.NEVER,
            "Largest difference of both wheels' speeds, for a second, that raises no alarm.",
        ),
    ] = 15.0

    ttl_max_ms: Annotated[
        int,
        Interval(ge=50, le=1_000),
        Key(
            "demand",
            Reload.SMALLER,
            "Longest time to live that a demand may carry: the dead-man's time.",
        ),
    ] = 1_000
    ttl_default_ms: Annotated[
        int,
        Interval(ge=50, le=1_000),
        Key(
            "demand",
            Reload.SMALLER,
            "Time to live of a demand that carries none; at most demand.ttl_max_ms, which is also"
            " the default where that is lower.",
        ),
    ] = 200
    priorities: Annotated[
        Mapping[SourceName, Priority],
        Key(
            "demand",
            Reload.LIVE,
            "Priority by source, as in {remote_stop: 10}: a source that is not listed has 0. While"
            " a demand is fresh, only a source of higher priority takes over.",
        ),
    ] = field(default_factory=dict)
    independent_directions: Annotated[
        bool,
        Key(
            "demand",
            Reload.LIVE,
            "Let a demand ask the motor controllers for different directions.",
        ),
    ] = False
    second_track_required: Annotated[
        bool,
        Key(
            "demand",
            Reload.LIVE,
            "Refuse a demand that does not carry the pedal's second track.",
        ),
    ] = False

    tuning: Tuning = field(default_factory=Tuning)
    pedals: CanPedals | None = None

    bench_demand: ControllerDemand | None = None
    auto_arm: Annotated[
        bool,
        Key(
            "bench",
            Reload.NEVER,
            "Arm once by itself, as soon as everything is healthy; otherwise the demand waits for"
            " `arm`.",
        ),
    ] = False

    @property
    def asymmetry_max_pct(self) -> float:
        """Most by which the throttles may differ where their demands do not."""
        return self.tuning.asymmetry_max_pct


def keys(settings: type) -> dict[str, Key]:
    """The `Key` of each field that has one, by the field's name, of this class of settings."""
    hints = get_type_hints(settings, include_extras=True)
    found = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
    return {
        name: marker
        for name, metadata in found.items()
        for marker in metadata
        if isinstance(marker, Key)
    }


KEYS: Mapping[str, Key] = keys(Settings)
"""The configuration's key of each field; a field that is not here is in no file."""

RESTART_ONLY = (
    *(
        item.name
        for item in fields(Settings)
        if item.name != "tuning"
        and (item.name not in KEYS or KEYS[item.name].reload is Reload.NEVER)
    ),
    tuning_module.START_KEY,
)
"""Fields, and keys of the tuning, that are read once, at the start."""


def changed(before: Settings, after: Settings) -> tuple[str, ...]:
    """Names of the fields that differ, and whole keys of what differs in the tuning."""
    names = [item.name for item in fields(Settings) if item.name != "tuning"]
    differ = [name for name in names if getattr(before, name) != getattr(after, name)]
    return (*differ, *tuning_module.changed(before.tuning, after.tuning))


def loosened(before: Settings, after: Settings) -> tuple[str, ...]:
    """As `changed`, what `after` changes otherwise than towards a stricter value."""
    return tuple(name for name in changed(before, after) if not _is_stricter(name, before, after))


def _is_stricter(name: str, before: Settings, after: Settings) -> bool:
    if name not in KEYS:
        return tuning_module.is_stricter(name, before.tuning, after.tuning)
    reload, old, new = KEYS[name].reload, getattr(before, name), getattr(after, name)
    if reload is Reload.SMALLER:
        return bool(new < old)
    return reload is Reload.LARGER and bool(new > old)
