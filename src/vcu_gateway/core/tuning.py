"""Tuning: curves, drive modes and the slip limiter of the configuration, as values.

Every input that a curve may have and every pair of limit and input stands once, in `INPUTS` and
`DERATINGS`: the configuration's keys, ranges and directions, the schema and the laws are made from
them. What they mean: docs/safety.md, Tuning.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, Literal, NamedTuple

from annotated_types import Interval

from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import CONTROLLERS, PowerMode
from vcu_gateway.demand_ranges import RANGES, SPEED_LIMIT_HIGHEST_RPM

SPEED_LIMIT_LOWEST_RPM = 500
WHEELS = ("ARD2_SteeringWheel", ("WheelSpeedFL", "WheelSpeedFR"))
WHEELS_SATURATED_KMH = 65.5
"""What a front wheel's speed counts as where its signal is at its end (errata E4)."""


class Quantity(NamedTuple):
    """A quantity on an axis of a curve: as a key names it, with its range.

    Attributes:
        key: with its unit, such as motor_temperature_c.
        text: for people, without the unit.
        step: smallest distance of two points; the sensor's resolution. 0 on the y axis.
    """

    key: str
    text: str
    unit: str
    lowest: float
    highest: float
    step: float = 0.0


class Input(NamedTuple):
    """Input of a derating: signals of which the worst one counts.

    Attributes:
        messages: names of messages, each with signals of it.
    """

    quantity: Quantity
    messages: tuple[tuple[str, tuple[str, ...]], ...]


def _of_both(message: str, signal: str) -> tuple[tuple[str, tuple[str, ...]], ...]:
    return tuple((f"{name}_{message}", (signal,)) for name in CONTROLLERS)


_PACKS = (("BMS_Temperatures", tuple(f"PackTemperature{number}" for number in range(1, 6))),)
_INPUTS = (
    Input(
        Quantity("motor_temperature_c", "motor temperature", "°C", 0, 255, 1),
        _of_both("Status1", "MotorTemperature"),
    ),
    Input(
        Quantity("controller_temperature_c", "controller temperature", "°C", 0, 150, 1),
        _of_both("Status1", "ControllerTemperature"),
    ),
    Input(
        Quantity("pack_temperature_max_c", "highest pack temperature", "°C", -50, 200, 1), _PACKS
    ),
    Input(Quantity("pack_temperature_min_c", "lowest pack temperature", "°C", -50, 200, 1), _PACKS),
    Input(Quantity("soc_pct", "state of charge", "%", 0, 100, 1), (("BMS_Status", ("SOC",)),)),
    Input(
        Quantity("battery_voltage_v", "battery voltage", "V", 0, 512, 0.1),
        _of_both("Status2", "BatteryVoltage"),
    ),
    Input(
        Quantity("motor_speed_rpm", "motor speed", "rpm", 0, SPEED_LIMIT_HIGHEST_RPM, 10),
        _of_both("Status2", "MotorSpeed"),
    ),
)
INPUTS: Mapping[str, Input] = {one.quantity.key: one for one in _INPUTS}
"""Inputs of deratings, by the name that a key has for them."""

PEDAL = Quantity("pedal_pct", "pedal", "%", 0, 100, 1)
SPEED = Quantity("speed_kmh", "speed", "km/h", 0, 65, 1)

Limit = Literal["power_limit_w", "brake_pct", "speed_limit_rpm"]
LIMITS: Mapping[str, Quantity] = {
    "power_limit_w": Quantity("power_limit_w", "power", "W", *RANGES["power_limit_w"]),
    "brake_pct": Quantity("brake_pct", "brake", "%", *RANGES["brake_pct"]),
    "speed_limit_rpm": Quantity(
        "speed_limit_rpm", "speed", "rpm", SPEED_LIMIT_LOWEST_RPM, SPEED_LIMIT_HIGHEST_RPM
    ),
}
"""Limits that curves give, by their names in keys."""


class Derating(NamedTuple):
    """A pair of limit and input that a curve may be given for.

    Attributes:
        rises: the curve must not fall, and the lowest value of the input is the worst; else it must
            not rise, and the highest is.
        steepest: most that the limit may rise for each unit of the input; None for any.
        why: of the direction, for a refusal.
    """

    limit: Limit
    input: Input
    rises: bool
    why: str
    example: tuple[tuple[float, float], ...]
    steepest: float | None = None

    @property
    def name(self) -> str:
        """Key below `curves`, such as power_limit_w.by_soc_pct."""
        return f"{self.limit}.by_{self.input.quantity.key}"

    @property
    def key(self) -> str:
        """Whole key in the file; a cause that it gives has this name."""
        return f"curves.{self.name}"


_HOTTER = "falls where it is hotter"
_COLDER = "falls where it is colder"
_EMPTIER = "falls where the battery is emptier"
_FULLER = "falls where the battery is fuller"
_SLOWER = "falls where the motors turn slower"

_ROWS: tuple[tuple[Limit, str, bool, str, tuple[tuple[float, float], ...]], ...] = (
    ("power_limit_w", "motor_temperature_c", False, _HOTTER, ((95, 14000), (110, 6000), (125, 0))),
    ("power_limit_w", "controller_temperature_c", False, _HOTTER, ((75, 14000), (95, 2000))),
    ("power_limit_w", "pack_temperature_max_c", False, _HOTTER, ((45, 14000), (60, 0))),
    ("power_limit_w", "pack_temperature_min_c", True, _COLDER, ((-10, 3000), (5, 14000))),
    ("power_limit_w", "soc_pct", True, _EMPTIER, ((3, 1500), (10, 5000), (25, 14000))),
    ("power_limit_w", "battery_voltage_v", True, _EMPTIER, ((60, 1000), (67, 14000))),
    ("brake_pct", "soc_pct", False, _FULLER, ((90, 100), (98, 0))),
    ("brake_pct", "pack_temperature_max_c", False, _HOTTER, ((45, 100), (60, 0))),
    ("brake_pct", "controller_temperature_c", False, _HOTTER, ((75, 100), (95, 0))),
    ("brake_pct", "pack_temperature_min_c", True, _COLDER, ((0, 0), (10, 100))),
    ("brake_pct", "motor_speed_rpm", True, _SLOWER, ((150, 0), (600, 100))),
    ("speed_limit_rpm", "soc_pct", True, _EMPTIER, ((5, 1700), (15, 12000))),
)
_STEEPEST_W_PER_V = 2500.0

DERATINGS: Mapping[str, Derating] = {
    one.name: one
    for one in (
        Derating(
            limit, INPUTS[name], rises, why, example,
            _STEEPEST_W_PER_V if name == "battery_voltage_v" else None,
        )
        for limit, name, rises, why, example in _ROWS
    )
}  # fmt: skip
"""Every curve that may be given, by its key below `curves`."""


@dataclass(frozen=True, slots=True)
class DriveMode:
    """One drive mode; what is None or at its default caps nothing.

    Attributes:
        by_pedal: demanded throttle (%) to throttle (%).
        by_speed: speed (km/h) to throttle (%).
        rise_by_speed: speed (km/h) to the throttle's steepest rise (%/s).
        left_by_service: only the service level leaves it.
    """

    by_pedal: Curve | None = None
    by_speed: Curve | None = None
    rise_by_speed: Curve | None = None
    power_mode_max: PowerMode = PowerMode.TURBO
    power_limit_w: float | None = None
    brake_max_pct: float = 100.0
    speed_limit_kmh: float | None = None
    left_by_service: bool = False

    def limits(self, rpm_per_kmh: float) -> Mapping[Limit, float]:
        """What it limits of the fields that have ramps; inf is no limit."""
        power_w, speed_kmh = self.power_limit_w, self.speed_limit_kmh
        return {
            "power_limit_w": math.inf if power_w is None else power_w,
            "brake_pct": self.brake_max_pct,
            "speed_limit_rpm": math.inf if speed_kmh is None else speed_kmh * rpm_per_kmh,
        }


@dataclass(frozen=True, slots=True)
class SlipLimiter:
    """How far a driven wheel may be faster than the front wheels, and what happens beyond."""

    allowed_kmh: Annotated[float, Interval(ge=3, le=20)] = 5.0
    allowed_pct: Annotated[float, Interval(ge=5, le=50)] = 15.0
    cut_share_pct: Annotated[float, Interval(ge=10, le=80)] = 50.0
    wait_ms: Annotated[int, Interval(ge=150, le=1000)] = 250
    return_pct_per_s: Annotated[float, Interval(ge=2, le=50)] = 10.0
    lowest_throttle_pct: Annotated[float, Interval(ge=0, le=50)] = 10.0
    asymmetry_max_pct: Annotated[float, Interval(ge=0, le=30)] = 20.0


@dataclass(frozen=True, slots=True)
class Tuning:
    """Curves, drive modes and laws of a configuration; by default nothing.

    Attributes:
        curves: by the names of `DERATINGS`.
        start: drive mode of every start; None where there are none.
        modes: by name.
        slip: None is off.
        motor_rpm_per_kmh: motor speed for each km/h; None where it is not known.
        mode_limits: what each mode limits of the fields that have ramps, by its name; made here.
    """

    curves: Mapping[str, Curve] = field(default_factory=dict)
    start: str | None = None
    modes: Mapping[str, DriveMode] = field(default_factory=dict)
    slip: SlipLimiter | None = None
    motor_rpm_per_kmh: float | None = None
    mode_limits: Mapping[str, Mapping[Limit, float]] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        rpm_per_kmh = self.motor_rpm_per_kmh or math.inf
        limits = {name: mode.limits(rpm_per_kmh) for name, mode in self.modes.items()}
        object.__setattr__(self, "mode_limits", limits)

    @property
    def acts(self) -> bool:
        """Whether anything of it may cap a command."""
        return bool(self.curves or self.modes) or self.slip is not None

    @property
    def asymmetry_max_pct(self) -> float:
        """Most by which throttles of equal demands may differ."""
        return 0.0 if self.slip is None else self.slip.asymmetry_max_pct


START_KEY = "drive_modes.start"
RPM_PER_KMH_KEY = "vehicle.motor_rpm_per_kmh"
_MODES = "drive_modes.modes."
_SLIP = "laws.slip."


def changed(before: Tuning, after: Tuning) -> tuple[str, ...]:
    """Whole keys of what differs."""
    if before == after:
        return ()
    old, new = values(before), values(after)
    return tuple(key for key in {**old, **new} if old.get(key) != new.get(key))


def values(tuning: Tuning) -> Mapping[str, object]:
    """What is configured, by its whole key in the file."""
    modes = {
        f"{_MODES}{name}.{MODE_KEYS.get(one.name, one.name)}": getattr(mode, one.name)
        for name, mode in tuning.modes.items()
        for one in fields(DriveMode)
    }
    found: dict[str, object] = {
        RPM_PER_KMH_KEY: tuning.motor_rpm_per_kmh,
        **{DERATINGS[name].key: curve for name, curve in tuning.curves.items()},
        START_KEY: tuning.start,
        **modes,
    }
    if tuning.slip is not None:
        found |= {
            f"{_SLIP}{one.name}": getattr(tuning.slip, one.name) for one in fields(SlipLimiter)
        }
    return found


MODE_KEYS: Mapping[str, str] = {
    "by_pedal": "throttle_pct.by_pedal_pct",
    "by_speed": "throttle_pct.by_speed_kmh",
    "rise_by_speed": "throttle_rise_pct_per_s.by_speed_kmh",
}
"""Keys of a drive mode's curves; every other field's key is its name."""
_FIELDS = {key: name for name, key in MODE_KEYS.items()}


def is_stricter(key: str, before: Tuning, after: Tuning) -> bool:
    """True for a curve that is new, or nowhere above the one before."""
    name = key.removeprefix("curves.")
    old, new = before.curves.get(name), after.curves.get(name)
    return new is not None and (old is None or new.nowhere_above(old))


def of_values(given: Mapping[str, Any]) -> Tuning:
    """Tuning of what `values` gave, also with curves as lists and power modes by name.

    Keys that are None or missing are not configured. KeyError, TypeError or ValueError for others.
    """
    found = {key: one for key, one in given.items() if one is not None}
    curves = {
        one.name: _curve(found.pop(one.key)) for one in DERATINGS.values() if one.key in found
    }
    modes: dict[str, dict[str, Any]] = {}
    slip: dict[str, Any] = {}
    start, rpm_per_kmh = found.pop(START_KEY, None), found.pop(RPM_PER_KMH_KEY, None)
    for key, value in found.items():
        if key.startswith(_MODES):
            name, _, part = key.removeprefix(_MODES).partition(".")
            modes.setdefault(name, {})[_FIELDS.get(part, part)] = _mode_value(part, value)
        elif key.startswith(_SLIP):
            slip[key.removeprefix(_SLIP)] = value
        else:
            raise KeyError(key)
    return Tuning(
        curves,
        start,
        {name: DriveMode(**own) for name, own in modes.items()},
        SlipLimiter(**slip) if slip else None,
        rpm_per_kmh,
    )


def _mode_value(part: str, value: Any) -> Any:
    if part in _FIELDS:
        return _curve(value)
    if part == "power_mode_max" and isinstance(value, str):
        return PowerMode[value.upper()]
    return value


def _curve(points: Any) -> Curve:
    if isinstance(points, Curve):
        return points
    return Curve(tuple((float(x), float(y)) for x, y in points))
