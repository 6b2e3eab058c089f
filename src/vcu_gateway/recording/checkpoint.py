"""Checkpoint: the state of the core as JSON, and a core restored from it.

Theory of operation
-------------------
`state_of` walks over the objects of a gateway and writes down every attribute. What the codec and
the settings give is left out (`_DERIVED`): `restore` builds a gateway of the same codec and of
settings, the recorded ones or others, takes those attributes from it and everything else from the
state. Nothing is ever run that a state names: classes are looked up among the values and parts of
the core.

    3, 2.5, "text", true, null          themselves
    {"float": "-inf"}                   a number that JSON does not have
    {"bytes": "0c00"}                   bytes
    {"enum": ["Mode", "ACTIVE"]}        member of an enumeration
    {"list": [...]}                     list; also tuple, set, frozenset
    {"deque": [80, [...]]}              its largest length, its items
    {"dict": [[key, value], ...]}       mapping
    {"Supervisor": {...}}               object with its attributes
    {"LinkStatus": [...]}               value (named tuple): its fields in order
    {"ref": 12}                         what was begun as the 12th of all these, counted from 0

Objects that two places share are shared again: the link monitor, the pedals and the coded signals
compare by identity.
"""

import dataclasses
import importlib
import math
import pkgutil
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from typing import Any

from vcu_gateway import core
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.commands import NOT_CAPPED
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.laws import Laws
from vcu_gateway.core.pedal_frames import PedalFrames
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.core.tuning import Tuning

_DERIVED: Mapping[str, frozenset[str]] = {
    name: frozenset(attributes.split())
    for name, attributes in {
        "Gateway": "settings _stop_watch",
        "Receiver": "_codec _controller_of _pedals_message command_groups echoes",
        "PedalFrames": "_expiry_ns _reader _last",
        "Store": "_specs _stale_after_ns _pickers _indexes",
        # What arrived before the last tick is looked at in that tick alone.
        "Snapshot": "_specs _indexes _pickers _arrived",
        "Transmitter": "_codecs _can_ids _same_layout _throttle _throttle_byte _direction_byte"
        " _reverse taken",
        "Gate": "allowed limits",
        "InputCollector": "_late_after_ns",
        "ModeManager": "_period_ns",
        "ListenBeforeTalk": "_listen_ns",
        "OperatorRequests": "terms",
        "Laws": "_kept",
        "Deratings": "_configured _readers _reading _over _said _curves"
        " _of_modes _on_the_way _result",
    }.items()
}
"""Attributes by class that the codec and the settings give, or that are made again.

What is known of a stop is among these: it decides nothing, and the frames that follow tell it anew.
"""

_LATER: Mapping[str, Mapping[str, Any]] = {
    "OperatorRequests": {
        "restart_state_failure": None,
        "pedal_frames": PedalFrames(None, Codec(ProtocolSpec((), {}))),
    },
    "Receiver": {"pedal_frames": []},
    "Gateway": {"_laws": Laws(Tuning())},
    "Commander": {"caps": NOT_CAPPED},
}
"""Attributes by class that came later, with what a state means by leaving them out."""

_SCALARS = frozenset({bool, int, str, type(None)})


class StateError(ValueError):
    """A checkpoint does not fit this version of the core; the text says where."""


def state_of(gateway: Gateway) -> dict[str, Any]:
    """State of a core between two calls, for JSON."""
    state: dict[str, Any] = _Encoder().encoded(gateway)
    return state


def restore(state: Any, codec: Codec, settings: Settings) -> Gateway:
    """A core in this state; StateError where the state is damaged or of another version.

    `settings` may be others than those with which the state was taken.
    """
    twin = Gateway(codec, settings, 0)
    try:
        gateway = _Decoder().root(state, twin)
    except StateError:
        raise
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise StateError(f"the state is damaged ({type(error).__name__}: {error})") from error
    gateway.fit_laws()
    return gateway


def _attributes(kind: type, one: Any) -> list[str]:
    """Names of an object's attributes, in an order that is the same in every Python."""
    names: Iterable[str] = vars(one) if hasattr(one, "__dict__") else kind.__dict__["__slots__"]
    return sorted(set(names) - _DERIVED.get(kind.__name__, frozenset()))


class _Encoder:
    """One walk: objects are numbered in the order in which they are begun."""

    def __init__(self) -> None:
        self._numbers: dict[int, int] = {}
        self._kept: list[object] = []

    def encoded(self, one: Any) -> Any:
        kind = type(one)
        if kind in _SCALARS:
            return one
        if kind is float:
            return one if math.isfinite(one) else {"float": repr(one)}
        if isinstance(one, Enum):
            return {"enum": [kind.__name__, one.name]}
        if kind is bytes:
            return {"bytes": one.hex()}
        if kind in (tuple, frozenset) and not one:
            return {kind.__name__: []}  # which of them are one object is Python's affair
        number = self._numbers.setdefault(id(one), len(self._kept))
        if number < len(self._kept):
            return {"ref": number}
        self._kept.append(one)  # what is made on the way must not take another's id
        return self._container(kind, one)

    def _container(self, kind: type, one: Any) -> Any:
        encoded = self.encoded
        if kind in (list, tuple):
            return {kind.__name__: [encoded(item) for item in one]}
        if kind is dict:
            return {"dict": [[encoded(key), encoded(value)] for key, value in one.items()]}
        if kind in (set, frozenset):
            return {kind.__name__: [encoded(item) for item in sorted(one, key=_sort_key)]}
        if kind is deque:
            return {"deque": [one.maxlen, [encoded(item) for item in one]]}
        # The core's class, whatever shell class was made of it.
        kind = next((cls for cls in kind.__mro__ if cls.__module__.startswith(core.__name__)), kind)
        if kind.__name__ not in _CLASSES:
            raise TypeError(f"a checkpoint cannot hold {kind.__module__}.{kind.__name__}")
        if isinstance(one, tuple):
            return {kind.__name__: [encoded(item) for item in one]}
        later = _LATER.get(kind.__name__, {})
        names = [
            name
            for name in _attributes(kind, one)
            if name not in later or getattr(one, name) != later[name]
        ]
        return {kind.__name__: {name: encoded(getattr(one, name)) for name in names}}


def _sort_key(item: Any) -> str:
    return item.name if isinstance(item, Enum) else repr(item)


class _Decoder:
    """One walk in the order of the encoder's; `twin` is what the settings give at each place."""

    def __init__(self) -> None:
        self._made: list[Any] = []

    def root(self, state: Any, twin: Gateway) -> Gateway:
        if not isinstance(state, dict) or list(state) != ["Gateway"]:
            raise StateError("the state is not that of a gateway")
        self._made.append(twin)
        self._fill(twin, Gateway, state["Gateway"], twin)
        return twin

    def decoded(self, value: Any, twin: Any) -> Any:
        if not isinstance(value, dict):
            if isinstance(value, list):
                raise StateError("a list without its kind")
            return value
        ((kind, content),) = value.items()
        simple = _SIMPLE.get(kind)
        if simple is not None:
            return simple(content)
        if kind == "ref":
            return self._shared(content)
        if content == [] and kind in ("tuple", "frozenset"):
            return _ITEMS[kind](content)
        place = len(self._made)
        self._made.append(_UNFINISHED)
        return self._container(place, kind, content, twin)

    def _shared(self, number: Any) -> Any:
        if type(number) is not int or not 0 <= number < len(self._made):
            raise StateError(f"a reference to object {number!r:.20}, which is not there")
        if self._made[number] is _UNFINISHED:
            raise StateError(f"object {number} holds itself")
        return self._made[number]

    def _container(self, place: int, kind: str, content: Any, twin: Any) -> Any:
        if kind == "dict":
            return self._mapping(place, content, twin if isinstance(twin, dict) else {})
        if kind in _ITEMS:
            made = _ITEMS[kind]([self.decoded(item, None) for item in content])
        elif kind == "deque":
            most, values = content
            made = deque([self.decoded(item, None) for item in values], maxlen=most)
        else:
            return self._instance(place, kind, content, twin)
        self._made[place] = made
        return made

    def _mapping(self, place: int, content: Any, twin: Mapping[Any, Any]) -> dict[Any, Any]:
        made: dict[Any, Any] = {}
        self._made[place] = made
        for key_value, value in content:
            key = self.decoded(key_value, None)
            made[key] = self.decoded(value, twin.get(key))
        return made

    def _instance(self, place: int, name: str, content: Any, twin: Any) -> Any:
        kind = _CLASSES.get(name)
        if kind is None or issubclass(kind, Enum):
            raise StateError(f"this version has no {name}")
        if issubclass(kind, tuple):
            items = [self.decoded(item, None) for item in content]
            fields = getattr(kind, "_fields", items)
            if len(fields) != len(items):
                raise StateError(f"{kind.__name__} has {len(items)} fields, here {len(fields)}")
            self._made[place] = tuple.__new__(kind, items)
            return self._made[place]
        is_plain = dataclasses.is_dataclass(kind) and name not in _DERIVED
        if not is_plain and type(twin) is not kind:
            raise StateError(f"{name} stands where this version has none")
        made = self._made[place] = object.__new__(kind)  # what it holds may refer to it
        self._fill(made, kind, content, None if is_plain else twin)
        return made

    def _fill(self, made: Any, kind: type, content: Any, twin: Any) -> None:
        """Lay the attributes of a state over what the codec and the settings give."""
        if twin is None:
            expected = sorted(item.name for item in dataclasses.fields(kind))
        else:
            expected = _attributes(kind, twin)
        later = _LATER.get(kind.__name__, {})
        if sorted({*later, *content}) != expected:
            odd = ", ".join(sorted({*later, *content}.symmetric_difference(expected)))
            raise StateError(f"{kind.__name__} has other attributes in this version: {odd}")
        for name in expected:
            own = getattr(twin, name, None)
            if name in content:
                value = self.decoded(content[name], own)
            else:
                value = later[name] if own is None else own
            object.__setattr__(made, name, value)
        if made is not twin:
            for name in _DERIVED.get(kind.__name__, ()):
                object.__setattr__(made, name, getattr(twin, name))


_UNFINISHED = object()
_ITEMS: Mapping[str, Callable[[list[Any]], Any]] = {
    "list": list,
    "tuple": tuple,
    "set": set,
    "frozenset": frozenset,
}


_MODULES = [f"{core.__name__}.{found.name}" for found in pkgutil.iter_modules(core.__path__)]
_CLASSES: Mapping[str, type] = {
    name: one
    for module in _MODULES
    for name, one in vars(importlib.import_module(module)).items()
    if isinstance(one, type) and one.__module__ == module
}
"""Every class of the core by its name; a name stands once."""


def _enum(content: Any) -> Enum:
    name, member = content
    kind = _CLASSES.get(name)
    if kind is None or not issubclass(kind, Enum):
        raise StateError(f"this version has no enumeration {name!r:.40}")
    try:
        return kind[member]
    except KeyError:
        raise StateError(f"this version has no {name}.{member}") from None


_SIMPLE: Mapping[str, Callable[[Any], Any]] = {
    "enum": _enum,
    "bytes": bytes.fromhex,
    "float": {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}.__getitem__,
}
