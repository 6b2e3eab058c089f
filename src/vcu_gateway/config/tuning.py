"""Sections of the configuration for curves, drive modes and laws (docs/tuning.md).

They are made from the tables of core/tuning.py: a curve that may be given there is a key here, with
its range, its direction and its refusals.
"""

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import (
    BeforeValidator,
    Field,
    StringConstraints,
    WithJsonSchema,
    create_model,
    field_validator,
)

from vcu_gateway.core import tuning
from vcu_gateway.core.tuning import (
    DERATINGS,
    LIMITS,
    PEDAL,
    SPEED,
    SPEED_LIMIT_LOWEST_RPM,
    Derating,
    Quantity,
    SlipLimiter,
    Tuning,
)
from vcu_gateway.demand_ranges import POWER_LIMIT_HIGHEST_W, RANGES
from vcu_gateway.errors import did_you_mean
from vcu_gateway.strict_yaml.file_text import FileProblem, KeyPath, PointIndex, shown
from vcu_gateway.strict_yaml.validation import Section, refusal

_FEWEST, _MOST = 2, 16
_MOST_MODES = 8
_THROTTLE = Quantity("throttle_pct", "throttle", "%", *RANGES["throttle_pct"])
_THROTTLE_OVER_SPEED = _THROTTLE._replace(lowest=5)
_RISE = Quantity("throttle_rise_pct_per_s", "rise", "%/s", 5, 200)
_CONSTANTS = {
    "power_limit_w": "a constant is limits.power_limit_max_w",
    "speed_limit_rpm": "a constant is limits.speed_limit_max_rpm",
}
_WRITE = "write [[x, y], [x, y]]"
_WORDS = ("temperature", "state of charge", "voltage", "speed", "pedal")

_Point = tuple[float, float]
_Points = tuple[_Point, ...]


def refused_point(index: int, what: str, remedy: str = "") -> Exception:
    return refusal(what, remedy, place=(PointIndex(index),), complete=True)


def checked_points(
    value: Any,
    x: Quantity,
    y: Quantity,
    *,
    rises: bool,
    why: str = "",
    steepest: float | None = None,
) -> _Points:
    """The points of a curve; a refusal names the first one that is wrong.

    A curve that `rises` must not fall, any other one must not rise; `why` says of which nature that
    is. `steepest` is the most that y may rise for each unit of x.
    """
    if not isinstance(value, list | tuple):
        raise refusal(f"must be a list of points, not {shown(value)}", _WRITE, complete=True)
    if not _FEWEST <= len(value) <= _MOST:
        what = f"must have {_FEWEST} to {_MOST} points, not {len(value)}"
        raise refusal(what, _CONSTANTS.get(y.key, ""), complete=True)
    points: list[_Point] = []
    for index, given in enumerate(value):
        point = _point(index, given, x, y)
        if points:
            _check_step(index, points[-1], point, x, y, rises, why)
            _check_slope(index, points[-1], point, x, y, steepest)
        points.append(point)
    return tuple(points)


def _point(index: int, given: Any, x: Quantity, y: Quantity) -> _Point:
    if not isinstance(given, list | tuple):
        raise refused_point(index, f"must be [x, y], not {shown(given)}")
    if len(given) != 2:
        raise refused_point(index, f"must be [x, y], not {len(given)} numbers")
    for number in given:
        if type(number) not in (int, float) or not math.isfinite(number):
            what = f"must be two numbers in {x.unit} and {y.unit}, not {shown(number)}"
            raise refused_point(index, what, "write the plain number")
    for name, number, axis in (("x", given[0], x), ("y", given[1], y)):
        if not axis.lowest <= number <= axis.highest:
            span = f"{_text(axis.lowest)} to {_text(axis.highest)} {axis.unit}"
            raise refused_point(index, f"{name} must be {span}, not {_text(number)}")
    return float(given[0]), float(given[1])


def _check_step(
    index: int, before: _Point, point: _Point, x: Quantity, y: Quantity, rises: bool, why: str
) -> None:
    if point[0] < before[0] + x.step - 1e-9:
        what = (
            f"{_text(point[0])} {x.unit} must lie at least {_text(x.step)} {x.unit} above the point"
            f" before, {_text(before[0])} {x.unit}"
        )
        raise refused_point(index, what, "x rises from point to point")
    if point[1] < before[1] if rises else point[1] > before[1]:
        word = next(one for one in _WORDS if x.text.endswith(one))
        values = f"{_text(point[1])} {y.unit} after {_text(before[1])} {y.unit}"
        what = f"must not {'fall' if rises else 'rise'} with the {word}: {values}"
        raise refused_point(index, what, f"{y.text} {why}" if why else "")


def _check_slope(
    index: int, before: _Point, point: _Point, x: Quantity, y: Quantity, steepest: float | None
) -> None:
    slope = (point[1] - before[1]) / (point[0] - before[0])
    if steepest is not None and slope > steepest * (1 + 1e-9):
        what = f"rises by {slope:.0f} {y.unit} per {x.unit}, at most {_text(steepest)}"
        remedy = (
            f"steeper, {y.text} and {x.text.split()[-1]} chase each other. Write it up to what a"
            " motor really takes, as limits.power_limit_max_w"
        )
        raise refused_point(index, what, remedy)


def _text(number: float) -> str:
    return f"{number:.10g}"


def curve_type(
    check: Callable[[Any], _Points], x: Quantity, y: Quantity, rises: bool, example: Any, text: str
) -> Any:
    """Type and default of a curve's key: None, or points that this check takes."""
    schema = {
        "anyOf": [
            {"type": "null"},
            {
                "type": "array",
                "minItems": _FEWEST,
                "maxItems": _MOST,
                "items": {
                    "type": "array",
                    "prefixItems": [
                        {"type": "number", "minimum": axis.lowest, "maximum": axis.highest}
                        for axis in (x, y)
                    ],
                    "items": False,
                    "minItems": 2,
                },
            },
        ],
        "x-unit": [x.unit, y.unit],
        "x-direction": "must not fall" if rises else "must not rise",
    }

    def unless_empty(value: Any) -> Any:
        return None if value is None else check(value)

    kind = Annotated[
        _Points | None, Field(strict=False), BeforeValidator(unless_empty), WithJsonSchema(schema)
    ]
    return kind, Field(default=None, description=text, examples=[example])


_LIVE_LOWER = "live, while active only a curve that is nowhere higher"


def _axes(x: Quantity, y: Quantity, rises: bool) -> str:
    return (
        f"x {_text(x.lowest)} to {_text(x.highest)} {x.unit}, y {_text(y.lowest)} to"
        f" {_text(y.highest)} {y.unit}, must not {'fall' if rises else 'rise'}"
    )


def _derating_type(one: Derating) -> Any:
    x, y = one.input.quantity, LIMITS[one.limit]
    example = [list(point) for point in one.example]
    text = f"{y.text.capitalize()} over {x.text}: {_axes(x, y, one.rises)}; {_LIVE_LOWER}."

    def check(value: Any) -> _Points:
        return checked_points(value, x, y, rises=one.rises, why=one.why, steepest=one.steepest)

    return curve_type(check, x, y, one.rises, example, text)


class _LimitSection(Section):
    alike = tuple({f"by_{one.input.quantity.key}": one for one in DERATINGS.values()})


class _CurvesSection(Section):
    alike = tuple(LIMITS)


def _curves_section() -> Any:
    sections: dict[str, Any] = {}
    for limit, quantity in LIMITS.items():
        own = {
            f"by_{one.input.quantity.key}": _derating_type(one)
            for one in DERATINGS.values()
            if one.limit == limit
        }
        text = f"{quantity.text.capitalize()} in {quantity.unit}, of each motor controller."
        name = f"{quantity.text.capitalize()}CurvesSection"
        kind = create_model(name, __base__=_LimitSection, __module__=__name__, __doc__=text, **own)
        sections[limit] = kind, Field(default=kind(), description=text)
    return create_model(
        "CurvesSection",
        __base__=_CurvesSection,
        __module__=__name__,
        __doc__="Limits over temperature, charge, voltage and speed; of all the lowest counts.",
        **sections,
    )


CurvesSection = _curves_section()


class VehicleSection(Section):
    """What the vehicle is: measured, not chosen."""

    motor_rpm_per_kmh: float | None = Field(
        default=None,
        ge=5,
        le=500,
        description="Motor speed for each km/h of the vehicle. `vcu-gateway replay NAME` measures"
        " it from a drive. Live, but not while active.",
        examples=[85.3],
    )


def _pedal_map(value: Any) -> _Points:
    points = checked_points(value, PEDAL, _THROTTLE, rises=True)
    if points[0] != (0.0, 0.0):
        raise refused_point(0, "must be [0, 0]", "a released pedal asks for nothing")
    for index, (pedal, throttle) in enumerate(points):
        if throttle > pedal:
            what = f"a pedal of {_text(pedal)} % gives {_text(throttle)} %, more than is asked"
            raise refused_point(index, what, f"at most {_text(pedal)}")
    if points[-1][0] != PEDAL.highest:
        raise refused_point(len(points) - 1, "the last point must be at a pedal of 100 %")
    return points


def _over_speed(y: Quantity) -> Callable[[Any], _Points]:
    return lambda value: checked_points(value, SPEED, y, rises=True)


_ThrottleSection = create_model(
    "ThrottleSection",
    __base__=Section,
    __module__=__name__,
    __doc__="Throttle in % of a drive mode; of both curves the lower one counts.",
    by_pedal_pct=curve_type(
        _pedal_map, PEDAL, _THROTTLE, True, [[0, 0], [40, 20], [80, 55], [100, 80]],
        "Throttle over the demanded one, from [0, 0] to 100 % and never above it; without it as"
        " demanded. Live, but not while active.",
    ),
    by_speed_kmh=curve_type(
        _over_speed(_THROTTLE_OVER_SPEED), SPEED, _THROTTLE_OVER_SPEED, True,
        [[0, 30], [30, 60], [60, 100]],
        f"Throttle over the speed: {_axes(SPEED, _THROTTLE_OVER_SPEED, True)}; live, but not while"
        " active.",
    ),
)  # fmt: skip
_RiseSection = create_model(
    "RiseSection",
    __base__=Section,
    __module__=__name__,
    __doc__="Steepest rise of the throttle; never above limits.throttle_slew_pct_per_s.",
    by_speed_kmh=curve_type(
        _over_speed(_RISE), SPEED, _RISE, True, [[0, 20], [40, 60]],
        f"Rise over the speed: {_axes(SPEED, _RISE, True)}; live, but not while active.",
    ),
)  # fmt: skip


class DriveModeSection(Section):
    """A drive mode: what it leaves out limits nothing."""

    # Sections of curves are made from the core's tables; to the type checker they are variables.
    throttle_pct: _ThrottleSection = _ThrottleSection()  # type: ignore[valid-type]
    throttle_rise_pct_per_s: _RiseSection = _RiseSection()  # type: ignore[valid-type]
    power_mode_max: Literal["eco", "normal", "turbo"] = Field(
        default="turbo", description="The highest power mode that a demand is given."
    )
    power_limit_w: int | None = Field(
        default=None, ge=0, le=POWER_LIMIT_HIGHEST_W, description="Power of each motor controller.",
        examples=[8000],
    )  # fmt: skip
    brake_max_pct: float = Field(default=100.0, ge=0, le=100, description="The highest brake.")
    speed_limit_kmh: float | None = Field(
        default=None,
        ge=3,
        le=200,
        description="Speed of the vehicle, as SpeedLimit; at least 500 rpm. It needs"
        " vehicle.motor_rpm_per_kmh.",
        examples=[45],
    )
    left_by_service: bool = Field(
        default=False,
        description="Only the service level leaves this mode, and it is kept over a restart.",
    )


_MODE_NAME = "^[a-z][a-z0-9_]{0,15}$"


def _short_word(name: object) -> object:
    if isinstance(name, str) and not re.fullmatch(_MODE_NAME, name):
        what = "must be 1 to 16 small letters, digits or _, a letter first"
        raise refusal(what, "such as eco")
    return name


ModeName = Annotated[str, StringConstraints(pattern=_MODE_NAME), BeforeValidator(_short_word)]


class DriveModesSection(Section):
    """Drive modes: pedal map, rise, power mode and limits by name, one of them at a time."""

    start: str | None = Field(
        default=None,
        description="Mode of every start; required where there are modes. At the next start.",
        examples=["eco"],
    )
    modes: Mapping[ModeName, DriveModeSection] = Field(
        default={},
        description="At most 8 modes by name; live, but not while active.",
        json_schema_extra={"maxProperties": _MOST_MODES},
        examples=[{"eco": {"power_mode_max": "normal", "power_limit_w": 8000}}],
    )

    @field_validator("modes")
    @classmethod
    def _few(cls, modes: Mapping[str, DriveModeSection]) -> Mapping[str, DriveModeSection]:
        if len(modes) > _MOST_MODES:
            raise refusal(f"must be at most {_MOST_MODES} modes, not {len(modes)}", complete=True)
        return modes


_SLIP_TEXTS = {
    "allowed_kmh": "How much faster than the front wheels a driven wheel may be, in any case.",
    "allowed_pct": "How much faster besides, in per cent of the front wheels' speed.",
    "cut_share_pct": "Share of the throttle that is taken away from a wheel that spins.",
    "wait_ms": "Time that a cut has to act before the next one.",
    "return_pct_per_s": "How fast the throttle is given back.",
    "lowest_throttle_pct": "Throttle below which nothing is cut.",
    "asymmetry_max_pct": "Most by which both throttles may differ because of it.",
}


def _slip_section() -> Any:
    hints = get_type_hints(SlipLimiter, include_extras=True)
    keys: dict[str, Any] = {}
    for one in fields(SlipLimiter):
        description = f"{_SLIP_TEXTS[one.name]} Live, but not while active."
        keys[one.name] = hints[one.name], Field(default=one.default, description=description)
    text = "Limits how long a wheel spins; it is slow, and no traction control."
    return create_model("SlipSection", __base__=Section, __module__=__name__, __doc__=text, **keys)


SlipSection = _slip_section()


class LawsSection(Section):
    """Laws that measure what they do; off without their key."""

    # As above: made from SlipLimiter.
    slip: SlipSection | None = Field(  # type: ignore[valid-type]
        default=None,
        description="Slip limiter; {} takes every default. It needs vehicle.motor_rpm_per_kmh."
        " Live, but not while active.",
    )


TUNING_SECTIONS = ("vehicle", "curves", "drive_modes", "laws")


def tuning_of(sections: Mapping[str, Section]) -> Tuning:
    """The core's tuning of the sections by their names."""
    values: dict[str, Any] = {}
    for name in TUNING_SECTIONS:
        values |= flat(sections[name].model_dump(mode="python"), name)
    return tuning.of_values(values)


def flat(value: Any, key: str) -> dict[str, Any]:
    """Values by whole key; a mode without keys of its own is there all the same."""
    if not isinstance(value, dict):
        return {key: value}
    found: dict[str, Any] = {}
    for name, one in value.items():
        found |= flat(one, f"{key}.{name}")
    return found


def contradictions(
    vehicle: VehicleSection, drive_modes: DriveModesSection, laws: LawsSection
) -> Iterator[FileProblem]:
    """Problems of two keys together."""
    yield from _start_problems(drive_modes)
    rpm_per_kmh = vehicle.motor_rpm_per_kmh
    if laws.slip is not None and rpm_per_kmh is None:
        yield FileProblem(("laws", "slip"), _NEEDS_GEOMETRY)
    for name, mode in drive_modes.modes.items():
        path: KeyPath = ("drive_modes", "modes", name, "speed_limit_kmh")
        if mode.speed_limit_kmh is None:
            continue
        if rpm_per_kmh is None:
            remedy = "drive once, and vcu-gateway replay measures it"
            yield FileProblem(path, _NEEDS_GEOMETRY, remedy)
        elif (speed_rpm := mode.speed_limit_kmh * rpm_per_kmh) < SPEED_LIMIT_LOWEST_RPM:
            least_kmh = math.ceil(10 * SPEED_LIMIT_LOWEST_RPM / rpm_per_kmh) / 10
            what = f"is {speed_rpm:.0f} rpm, below the 500 rpm that are ever sent"
            yield FileProblem(path, what, f"at least {least_kmh:g}")


_NEEDS_GEOMETRY = "needs vehicle.motor_rpm_per_kmh"


def _start_problems(drive_modes: DriveModesSection) -> Iterator[FileProblem]:
    start, names = drive_modes.start, list(drive_modes.modes)
    path: KeyPath = ("drive_modes", "start")
    if start is None and names:
        yield FileProblem(path, "is missing", f"the mode of every start, such as {names[0]}")
    elif start is not None and start not in names:
        remedy = did_you_mean(start, names) or f"the modes are {', '.join(names) or 'none'}"
        yield FileProblem(path, f'there is no mode "{start}"', remedy)


_STANDS_STILL_W = 500


def without_effect(tuning: Tuning, highest: Mapping[str, float]) -> Iterator[FileProblem]:
    """Hints: curves that never limit a field of this highest value, and that stop the vehicle."""
    for name, curve in tuning.curves.items():
        derating = DERATINGS[name]
        path = ("curves", derating.limit, f"by_{derating.input.quantity.key}")
        unit, most = LIMITS[derating.limit].unit, highest[derating.limit]
        if curve.lowest >= most:
            yield FileProblem(path, f"never limits: every y is at least {_text(most)} {unit}")
        elif derating.limit == "power_limit_w" and curve.lowest < _STANDS_STILL_W:
            what = f"brings the power down to {_text(curve.lowest)} W: the vehicle stops there"
            yield FileProblem(path, what)
