"""What can be asked of the motor controllers, and what asks for no motion."""

import math
from collections.abc import Mapping
from typing import Any, TypedDict

from vcu_gateway.api.results import PowerModeName

CONTROLLERS = ("PCU1", "PCU2")


class Values(TypedDict, total=False):
    """Asked of one controller; what is left out is at the gateway's default."""

    throttle_pct: float
    """0 to 100."""
    throttle_track2_pct: float | None
    """0 to 100, the pedal's second track; None where there is none."""
    brake_pct: float
    """0 to 100."""
    power_mode: PowerModeName
    motor_reverse: bool
    regen_brake: bool
    speed_limit_rpm: float | None
    """0 to 12000; None is the configured maximum."""
    power_limit_w: float | None
    """0 to 60000; None is the configured maximum."""


class DemandRequest(Values, total=False):
    """The same for both controllers, or different values for each."""

    PCU1: Values
    PCU2: Values


RequestValues = Mapping[str, Mapping[str, Any]]
"""The part of a demand that says what: `values`, or `controllers`."""

# Both tracks, because the gateway may require the second.
NO_MOTION: RequestValues = {
    "values": {"throttle_pct": 0.0, "throttle_track2_pct": 0.0, "brake_pct": 0.0},
}


def request_values(asked: Mapping[str, Any]) -> RequestValues:
    """As the gateway takes it, which judges it; ValueError where a number is not finite."""
    controllers = {name: asked[name] for name in CONTROLLERS if name in asked}
    values = {name: asked[name] for name in asked if name not in CONTROLLERS}
    body: dict[str, Mapping[str, Any]] = {}
    if controllers:
        body["controllers"] = {name: _finite(one) for name, one in controllers.items()}
    if values or not controllers:
        body["values"] = _finite(values)
    return body


def without_motion(body: RequestValues) -> RequestValues:
    """No throttle and no brake; the direction stays, for changing it is a request of its own."""
    if "controllers" in body:
        controllers = body["controllers"]
        return {"controllers": {name: _still(controllers.get(name, {})) for name in CONTROLLERS}}
    return {"values": _still(body["values"])}


def _still(values: Mapping[str, Any]) -> Mapping[str, Any]:
    # Nothing else is copied: what was refused for a wrong value must not be refused again.
    if values.get("motor_reverse") is True:
        return {**NO_MOTION["values"], "motor_reverse": True}
    return NO_MOTION["values"]


def _finite(values: Mapping[str, Any]) -> Mapping[str, Any]:
    return {name: _finite_value(name, value) for name, value in values.items()}


def _finite_value(name: str, value: object) -> object:
    if value is None or isinstance(value, str | bool):
        return value
    try:
        number = float(value)  # type: ignore[arg-type]  # TypeError is the right answer
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError(f"{name} is {number}; it must be a finite number")
    return number
