"""Settings, demands and calls of the core as JSON, and back.

Each field of a call is written and read as its type says. The first one stands under the call's
word, every other one under its own name without the unit:

    Arm(5)                  "arm":5
    Reset(SERVICE, 5)       "reset":"service","now":5
    EmergencyStop()         "estop":true
"""

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields
from typing import Any, TypeVar

from vcu_gateway.core import calls, can_pedals, tuning
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import ControllerDemand, Demand, PowerMode
from vcu_gateway.core.gateway import CoreCall
from vcu_gateway.core.link import Carrier, LinkState, LinkStatus
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.units import NS_PER_US

_T = TypeVar("_T")
_NOT_FINITE = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
_SETTINGS = tuple(item.name for item in fields(Settings))
_DEFAULTS = Settings()
_LATER = (
    *("tuning", "pedals", "power_return_w_per_s", "brake_return_pct_per_s"),
    *("speed_fall_rpm_per_s", "speed_return_rpm_per_s"),
)
"""Settings that came later: left out at their defaults, so a drive without them is as before."""
_LEFT_OUT = {
    item.name: item.default
    for item in fields(ControllerDemand)
    if item.name not in ("throttle_pct", "power_mode")
}
"""Fields of a controller's demand that are written where they are not their default."""


def settings_json(settings: Settings) -> dict[str, Any]:
    values = {name: getattr(settings, name) for name in _SETTINGS}
    bench = settings.bench_demand
    values["bench_demand"] = None if bench is None else controller_json(bench)
    own = tuning.values(settings.tuning)
    values["tuning"] = {key: _tuning_json(value) for key, value in own.items()}
    values["pedals"] = None if settings.pedals is None else can_pedals.values(settings.pedals)
    for name in _LATER:
        if getattr(settings, name) == getattr(_DEFAULTS, name):
            del values[name]
    return values


def _tuning_json(value: Any) -> Any:
    if isinstance(value, Curve):
        return [list(point) for point in value.points]
    return value.name.lower() if isinstance(value, PowerMode) else value


def settings_of(values: Any) -> Settings:
    """Settings of what `settings_json` gave, with defaults for what is not there; or ValueError."""
    if not isinstance(values, dict):
        raise ValueError("the settings are no object")
    if unknown := sorted(set(values) - set(_SETTINGS)):
        raise ValueError(f"settings that this version does not know: {', '.join(unknown)}")
    return Settings(**{name: _setting(name, value) for name, value in values.items()})


def _setting(name: str, value: Any) -> Any:
    if name in _READERS:
        return _READERS[name](value)
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


def _reader(of_values: Callable[[Any], _T], what: str) -> Callable[[Any], _T]:
    """Reads by `of_values`; ValueError for whatever it cannot read."""

    def read(value: Any) -> _T:
        try:
            return of_values(value)
        except (AttributeError, KeyError, TypeError, ValueError) as error:
            raise ValueError(f"the {what} cannot be read: {error}") from error

    return read


def controller_json(demand: ControllerDemand) -> dict[str, Any]:
    """Demand of one controller; the power mode by its name."""
    return asdict(demand) | {"power_mode": demand.power_mode.name.lower()}


def controller_of(values: Mapping[str, Any]) -> ControllerDemand:
    """Demand of what `controller_json` gave, or of a part; ValueError, KeyError or TypeError."""
    numbers = {name: number_of(value) for name, value in values.items() if name != "power_mode"}
    return ControllerDemand(**numbers, power_mode=PowerMode[values["power_mode"].upper()])


def _or_none(read: Callable[[Any], object]) -> Callable[[Any], object]:
    return lambda value: None if value is None else read(value)


_READERS: Mapping[str, Callable[[Any], Any]] = {
    "bench_demand": _or_none(controller_of),
    "pedals": _or_none(_reader(can_pedals.of_values, "pedals")),
    "tuning": _reader(tuning.of_values, "tuning"),
}
"""How settings are read whose default does not tell their type."""


def demand_text(demand: Demand, now_ns: int) -> str:
    """JSON text of a source's demand offered at `now_ns`; `both` where its controllers share one.

    Written out: the general encoder takes four times as long, and there is a demand a tick. Short
    for that reason too: an age has fewer digits than a time, and left out is what nobody asked for,
    and a sequence that is the time in microseconds, as the client makes it.
    """
    made_ns = demand.made_ns
    age = "null" if made_ns is None else now_ns - made_ns
    source, ttl_ms = _quoted(demand.source), number_text(demand.ttl_ms)
    head = f'{{"source":{source},"ttl_ms":{ttl_ms},"age_ns":{age}'
    if made_ns is None or demand.sequence != made_ns // NS_PER_US:
        head += f',"sequence":{demand.sequence}'
    controllers = demand.controllers
    first = next(iter(controllers.values()), None)
    if first is not None and all(one is first for one in controllers.values()):
        names = ",".join(map(_quoted, controllers))
        return f'{head},"both":[{names}],"demand":{_controller_text(first)}}}'
    each = [f"{_quoted(name)}:{_controller_text(one)}" for name, one in controllers.items()]
    return f'{head},"each":{{{",".join(each)}}}}}'


def _controller_text(one: ControllerDemand) -> str:
    throttle, mode = number_text(one.throttle_pct), one.power_mode.name.lower()
    text = f'{{"throttle_pct":{throttle},"power_mode":"{mode}"'
    for name, default in _LEFT_OUT.items():
        if (value := getattr(one, name)) != default:
            text += f',"{name}":{number_text(value)}'
    return text + "}"


def number_text(value: float | None) -> str:
    """JSON text of a number, truth value or None; what JSON does not have becomes a word."""
    if value is None or isinstance(value, bool):
        return WORDS[value]
    return repr(value) if isinstance(value, int) or math.isfinite(value) else f'"{value!r}"'


WORDS = {None: "null", True: "true", False: "false"}
_quoted = json.encoder.encode_basestring_ascii


def demand_of(values: Mapping[str, Any], now_ns: int) -> Demand:
    """Demand of what `demand_text` gave; ValueError, KeyError or TypeError for others."""
    if "both" in values:
        controllers = dict.fromkeys(values["both"], controller_of(values["demand"]))
    else:
        controllers = {name: controller_of(one) for name, one in values["each"].items()}
    age_ns = values["age_ns"]
    made_ns = None if age_ns is None else now_ns - whole_of(age_ns)
    timely = None if made_ns is None else made_ns // NS_PER_US
    return Demand(
        source=text_of(values["source"]),
        sequence=whole_of(values.get("sequence", timely)),
        ttl_ms=None if values["ttl_ms"] is None else whole_of(values["ttl_ms"]),
        controllers=controllers,
        made_ns=made_ns,
    )


def number_of(value: Any) -> Any:
    if isinstance(value, str):
        return _NOT_FINITE[value]
    if value is None or isinstance(value, (int, float)):
        return value
    raise ValueError(f"{value!r:.40} is no number")


def _only(kind: type[_T], what: str) -> Callable[[Any], _T]:
    """Takes values of this type alone; ValueError for others."""

    def read(value: Any) -> _T:
        if isinstance(value, kind) and type(value) is kind:
            return value
        raise ValueError(f"{value!r:.40} is {what}")

    return read


whole_of = _only(int, "no whole number")
text_of = _only(str, "no text")
truth_of = _only(bool, "neither true nor false")
encoded = json.JSONEncoder(separators=(",", ":"), allow_nan=False, default=str).encode


def call_text(call: CoreCall[object]) -> str:
    """Members of a call's JSON object."""
    if type(call) is calls.Offer:  # a demand's age is told, not its time
        return f'"offer":{demand_text(call.demand, call.now_ns)},"now":{call.now_ns}'
    written = zip(_FIELDS[type(call)], call, strict=True)  # type: ignore[call-overload]
    members = [f'"{key}":{write(value)}' for (key, write, _), value in written]
    return ",".join(members) or f'"{calls.WORDS[type(call)]}":true'


def call_of(values: Mapping[str, Any]) -> CoreCall[object] | None:
    """Call of a line's object; None where it has none.

    ValueError, KeyError, TypeError or AttributeError where a field is not one of its type.
    """
    word = next((key for key in values if key in _KINDS), None)
    if word is None:
        return None
    if word == "offer":
        return calls.Offer(demand_of(values[word], whole_of(values["now"])), values["now"])
    kind = _KINDS[word]
    call: CoreCall[object] = kind(*[read(values[key]) for key, _, read in _FIELDS[kind]])
    return call


def out_frame_text(frame: OutFrame) -> str:
    return f'["{frame.controller}","{frame.can_id:08X}","{frame.data.hex()}"]'


def out_frame_of(values: Any) -> OutFrame:
    controller, can_id, data = values
    return OutFrame(text_of(controller), int(can_id, 16), bytes.fromhex(data))


def event_values(event: Event) -> list[Any]:
    return [event.name, event.severity.name.lower(), event.fields]


def event_of(values: Any) -> Event:
    name, severity, fields = values
    return Event(text_of(name), Severity[severity.upper()], dict(fields))


def _link_of(values: Any) -> LinkStatus:
    state, since_ns = values
    return LinkStatus(LinkState(state), whole_of(since_ns))


def _carrier_of(values: Any) -> Carrier:
    present, since_ns = values
    return Carrier(truth_of(present), whole_of(since_ns))


_Codec = tuple[Callable[[Any], str], Callable[[Any], Any]]
_Field = tuple[str, Callable[[Any], str], Callable[[Any], Any]]
_TYPES: Mapping[Any, _Codec] = {
    int: (str, whole_of),
    bool: (WORDS.__getitem__, truth_of),
    str: (encoded, text_of),
    str | None: (encoded, _or_none(text_of)),
    Mapping[str, bool]: (
        lambda one: encoded(dict(one)),
        lambda values: {name: truth_of(one) for name, one in values.items()},
    ),
    FaultClass: (lambda one: f'"{one.value}"', FaultClass),
    Carrier: (encoded, _carrier_of),
    Carrier | None: (encoded, _or_none(_carrier_of)),
    LinkStatus: (lambda one: encoded([one.state.value, one.since_ns]), _link_of),
    Settings: (lambda one: encoded(settings_json(one)), settings_of),
    OutFrame: (out_frame_text, out_frame_of),
}
"""How a field of each type is written and read; a demand needs the time of its offer, too."""


def _fields(kind: type, word: str) -> list[_Field]:
    types = kind.__annotations__
    keys = [word, *(name.removesuffix("_ns") for name in list(types)[1:])]
    return [(key, *_TYPES[one]) for key, one in zip(keys, types.values(), strict=False)]


_KINDS: Mapping[str, Any] = {word: kind for kind, word in calls.WORDS.items()}
_FIELDS = {kind: _fields(kind, word) for word, kind in _KINDS.items() if kind is not calls.Offer}
