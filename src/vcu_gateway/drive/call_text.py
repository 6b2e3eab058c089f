"""Calls of the core in a core line: each field is written and read as its type says.

A call's first field stands under its word, every other one under its own name without the unit:

    Arm(5)                  "arm":5
    Reset(SERVICE, 5)       "reset":"service","now":5
    EmergencyStop()         "estop":true
"""

import json
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from vcu_gateway.core import calls
from vcu_gateway.core.causes import Event, Severity
from vcu_gateway.core.gateway import CoreCall
from vcu_gateway.core.link import Carrier, LinkState, LinkStatus
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.drive.settings_json import (
    demand_of,
    demand_text,
    settings_json,
    settings_of,
    text_of,
    whole_of,
)

TRUTH = {True: "true", False: "false"}
_ENCODER = json.JSONEncoder(separators=(",", ":"), allow_nan=False, default=str)


def encoded(values: Any) -> str:
    return _ENCODER.encode(values)


def call_text(call: CoreCall[object]) -> str:
    """Members of a call's JSON object."""
    if type(call) is calls.Offer:  # a demand's age is told, not its time
        return f'"offer":{demand_text(call.demand, call.now_ns)},"now":{call.now_ns}'
    fields = _FIELDS[type(call)]
    members = [f'"{one.key}":{one.write(value)}' for one, value in zip(fields, call, strict=True)]  # type: ignore[call-overload]
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
    call: CoreCall[object] = kind(*[one.read(values[one.key]) for one in _FIELDS[kind]])
    return call


def truth_of(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{value!r:.40} is neither true nor false")
    return value


def _text_or_none(value: Any) -> str | None:
    return None if value is None else text_of(value)


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
_TYPES: Mapping[Any, _Codec] = {
    int: (str, whole_of),
    bool: (TRUTH.__getitem__, truth_of),
    str: (encoded, text_of),
    str | None: (encoded, _text_or_none),
    Mapping[str, bool]: (
        lambda one: encoded(dict(one)),
        lambda values: {name: truth_of(one) for name, one in values.items()},
    ),
    FaultClass: (lambda one: f'"{one.value}"', FaultClass),
    Carrier: (encoded, _carrier_of),
    Carrier | None: (encoded, lambda values: None if values is None else _carrier_of(values)),
    LinkStatus: (lambda one: encoded([one.state.value, one.since_ns]), _link_of),
    Settings: (lambda one: encoded(settings_json(one)), settings_of),
    OutFrame: (out_frame_text, out_frame_of),
}
"""How a field of each type is written and read; a demand needs the time of its offer, too."""


class _Field(NamedTuple):
    key: str
    write: Callable[[Any], str]
    read: Callable[[Any], Any]


def _fields(kind: type, word: str) -> tuple[_Field, ...]:
    types = kind.__annotations__
    keys = [word, *(name.removesuffix("_ns") for name in list(types)[1:])]
    return tuple(
        [_Field(key, *_TYPES[one]) for key, one in zip(keys, types.values(), strict=False)]
    )


_KINDS: Mapping[str, Any] = {word: kind for kind, word in calls.WORDS.items()}
_FIELDS = {kind: _fields(kind, word) for word, kind in _KINDS.items() if kind is not calls.Offer}
