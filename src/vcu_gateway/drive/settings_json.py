"""Settings of the core and demands as JSON, and back."""

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from vcu_gateway.core.demand import ControllerDemand, Demand, PowerMode
from vcu_gateway.core.settings import Settings

_NOT_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
_SETTINGS = {item.name: item for item in fields(Settings)}
_DEMAND = tuple(item.name for item in fields(ControllerDemand))
_DEFAULTS = Settings()


def settings_json(settings: Settings) -> dict[str, Any]:
    """Every field by its name."""
    values = {name: getattr(settings, name) for name in _SETTINGS}
    bench = settings.bench_demand
    return values | {"bench_demand": None if bench is None else controller_json(bench)}


def settings_of(values: Any) -> Settings:
    """Settings of what `settings_json` gave; a field that is not there has its default.

    Raises ValueError where a value cannot be taken, or a field is not known.
    """
    if not isinstance(values, dict):
        raise ValueError("the settings are no object")
    if unknown := sorted(values.keys() - _SETTINGS.keys()):
        raise ValueError(f"settings that this version does not know: {', '.join(unknown)}")
    return Settings(**{name: _setting(name, value) for name, value in values.items()})


def _setting(name: str, value: Any) -> Any:
    if name == "bench_demand":
        return None if value is None else controller_of(value)
    default = getattr(_DEFAULTS, name)
    if isinstance(default, tuple):
        if isinstance(value, list) and all(isinstance(one, str) for one in value):
            return tuple(value)
    elif isinstance(default, Mapping):
        if isinstance(value, dict) and all(type(one) is int for one in value.values()):
            return value
    elif type(value) is type(default) or {type(value), type(default)} == {int, float}:
        return value
    raise ValueError(f"the setting {name} cannot be {value!r:.40}")


def controller_json(demand: ControllerDemand) -> dict[str, Any]:
    """Demand of one controller; the power mode by its name."""
    values = {name: getattr(demand, name) for name in _DEMAND}
    return values | {"power_mode": demand.power_mode.name.lower()}


def controller_of(values: Mapping[str, Any]) -> ControllerDemand:
    """Demand of what `controller_json` gave; ValueError, KeyError or TypeError for others."""
    numbers = {name: number_of(value) for name, value in values.items() if name != "power_mode"}
    return ControllerDemand(**numbers, power_mode=PowerMode[values["power_mode"].upper()])


def demand_json(demand: Demand) -> dict[str, Any]:
    """Demand of a source; `both` where its controllers share one."""
    values = {
        "source": demand.source,
        "sequence": demand.sequence,
        "ttl_ms": demand.ttl_ms,
        "made_ns": demand.made_ns,
    }
    first = next(iter(demand.controllers.values()), None)
    if first is not None and all(one is first for one in demand.controllers.values()):
        return values | {"both": list(demand.controllers), "demand": controller_json(first)}
    each = {name: controller_json(one) for name, one in demand.controllers.items()}
    return values | {"each": each}


def demand_of(values: Mapping[str, Any]) -> Demand:
    """Demand of what `demand_json` gave; ValueError, KeyError or TypeError for others."""
    if "both" in values:
        controllers = dict.fromkeys(values["both"], controller_of(values["demand"]))
    else:
        controllers = {name: controller_of(one) for name, one in values["each"].items()}
    return Demand(
        source=_text(values["source"]),
        sequence=_whole(values["sequence"]),
        ttl_ms=None if values["ttl_ms"] is None else _whole(values["ttl_ms"]),
        controllers=controllers,
        made_ns=None if values["made_ns"] is None else _whole(values["made_ns"]),
    )


def finite(value: Any) -> Any:
    """JSON value in which numbers that JSON does not have are words: nan, inf, -inf."""
    if isinstance(value, dict):
        return {name: finite(one) for name, one in value.items()}
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    return value


def number_of(value: Any) -> Any:
    """Value of a JSON number, truth value or null, or of the words of `finite`."""
    if isinstance(value, str):
        return _NOT_FINITE[value]
    if value is None or isinstance(value, (int, float)):
        return value
    raise ValueError(f"{value!r:.40} is no number")


def _whole(value: Any) -> int:
    if type(value) is not int:
        raise ValueError(f"{value!r:.40} is no whole number")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{value!r:.40} is no text")
    return value
