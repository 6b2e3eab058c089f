"""State as a browser gets it twenty times a second: numbers in the definition's order, no names.

A part that is not as it should be is null, or the worst of its kind, and the others stay.

Whether an answer has the shape that api/results.py says, and where it has not.

A gateway of another version beside this page may leave out a field or send another type.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, TypeGuard, Union, get_args, get_origin

from typing_extensions import get_type_hints, is_typeddict

from vcu_gateway.api.results import SignalDefinition
from vcu_gateway.units import NS_PER_MS

_MOST_SHOWN = 40


def misfits(value: object, kind: Any, where: str) -> Iterator[str]:
    """A phrase for each part of `value` that is not of this type; fields that are new are none."""
    origin = get_origin(kind)
    if origin in (Union, UnionType):
        yield from _of_union(value, get_args(kind), where)
    elif origin is Literal:
        if value not in get_args(kind):
            yield f"{where} is {_shown(value)}"
    elif origin in (list, dict, Mapping):
        yield from _of_items(value, kind, where)
    elif is_typeddict(kind):
        yield from _of_fields(value, kind, where)
    elif not _is_of(value, kind):
        yield f"{where} is {_shown(value)}"


def _of_union(value: object, kinds: tuple[Any, ...], where: str) -> Iterator[str]:
    """None where that is allowed, else the one other type."""
    if value is None and NoneType in kinds:
        return
    others = [kind for kind in kinds if kind is not NoneType]
    yield from misfits(value, others[0], where)


def _of_items(value: object, kind: Any, where: str) -> Iterator[str]:
    """Items of a list or an object; their places are left out, so that a phrase stays the same."""
    container, arguments = get_origin(kind), get_args(kind)
    if not isinstance(value, container):
        yield f"{where} is {_shown(value)}"
        return
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from misfits(item, arguments[1], f"{where}.{key}")
    else:
        for item in value:
            yield from misfits(item, arguments[0], f"{where}[]")


def _of_fields(value: object, kind: Any, where: str) -> Iterator[str]:
    if not isinstance(value, dict):
        yield f"{where} is {_shown(value)}"
        return
    for name, of_field in _fields(kind).items():
        if name in value:
            yield from misfits(value[name], of_field, f"{where}.{name}")
        elif name in kind.__required_keys__:
            yield f"{where}.{name} is missing"


@cache
def _fields(kind: Any) -> dict[str, Any]:
    return get_type_hints(kind)


def _is_of(value: object, kind: Any) -> bool:
    if kind is Any:
        return True
    if isinstance(value, bool) or kind is bool:
        return type(value) is kind
    return isinstance(value, (int, float) if kind is float else kind)


def _shown(value: object) -> str:
    """A value that does not fit, as JSON calls it, short."""
    if value is None:
        return "null"
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    return repr(value)[:_MOST_SHOWN]


_QUALITY_LETTERS: dict[str, str] = {
    "good": "g",
    "out of range": "r",
    "saturated": "s",
    "stale": "o",
    "never": "n",
}
_UNKNOWN_QUALITY = "n"

Row = list[object]
"""Age in ms, observed period in ms, stale (0, 1), frames, values, a letter for each quality."""

SignalOrder = dict[str, tuple[str, ...]]
"""Names of the signals of each message, in the order in which a row has them."""

_OF_SIGNAL = ("name", "unit", "minimum", "maximum", "factor", "names", "comment")


def state_row(
    state: Mapping[str, Any], order: SignalOrder, received_ms: float
) -> dict[str, object]:
    """One state, small; `received_ms` is when it got here, on the clock of `t`."""
    messages = object_at(state, "messages").items()
    return {
        "t": state["monotonic_ns"] / NS_PER_MS,
        "received": received_ms,
        "mode": state.get("mode"),
        "messages": {name: _row(one, order.get(name, ())) for name, one in messages},
        "commands": state.get("commands"),
        "demanded": state.get("demanded"),
        "stop": state.get("stop"),
    }


def _row(message: Any, names: Sequence[str]) -> Row | None:
    """None for a message that is none."""
    if not isinstance(message, dict):
        return None
    signals = object_at(message, "signals")
    parts = [_signal(signals.get(name)) for name in names]
    return [
        _number(message.get("age_ms")),
        _number(message.get("period_ms")),
        int(message.get("stale") is not False),
        _number(message.get("frame_count")),
        [value for value, _ in parts],
        "".join(letter for _, letter in parts),
    ]


def _signal(signal: Any) -> tuple[float | None, str]:
    quality = part_of(signal, "quality")
    letter = _QUALITY_LETTERS.get(quality) if isinstance(quality, str) else None
    return _number(part_of(signal, "value")), letter or _UNKNOWN_QUALITY


def _number(value: object) -> float | None:
    """Without the digits that no signal of 16 bits has; None for what is no number."""
    if not is_number(value):
        return None
    return round(value, 4) if isinstance(value, float) else value


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether JSON has it as a number."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def part_of(value: Any, key: str) -> Any:
    """What an object has at this key; None where it is no object, too."""
    return value.get(key) if isinstance(value, dict) else None


def object_at(value: Any, key: str) -> dict[str, Any]:
    """The same where it is an object; else an empty one."""
    inner = part_of(value, key)
    return inner if isinstance(inner, dict) else {}


def definition(protocol: Any, received: Sequence[str]) -> dict[str, Any]:
    """What the page needs to name the numbers: messages in the state's order."""
    listed = part_of(protocol, "messages") or ()
    known = {one["name"]: one for one in listed if isinstance(part_of(one, "name"), str)}
    return {
        "digest": part_of(protocol, "digest"),
        "messages": [_message(known[name]) for name in received if name in known],
    }


def _message(message: Any) -> dict[str, object]:
    """One message with those of its signals that have everything."""
    signals = message.get("signals")
    signals = signals if isinstance(signals, list) else []
    whole = [one for one in signals if not any(misfits(one, SignalDefinition, ""))]
    return {
        "name": message["name"],
        "sender": message.get("sender"),
        "id": message.get("can_id"),
        "period_ms": message.get("period_ms"),
        "signals": [{key: one[key] for key in _OF_SIGNAL} for one in whole],
    }


def signal_order(told: Mapping[str, Any], received: Sequence[str]) -> SignalOrder:
    """Order of the signals in the rows, by what the browsers were told."""
    names = {one["name"]: tuple(s["name"] for s in one["signals"]) for one in told["messages"]}
    return {name: names.get(name, ()) for name in received}
