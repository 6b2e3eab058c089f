"""Whether an answer has the shape that api/results.py says, and where it has not.

A gateway of another version beside this page may leave out a field or send another type.
"""

from collections.abc import Iterator, Mapping
from functools import cache
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin

from typing_extensions import get_type_hints, is_typeddict

_NUMBERS = (int, float)
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
    return isinstance(value, _NUMBERS if kind is float else kind)


def _shown(value: object) -> str:
    """A value that does not fit, as JSON calls it, short."""
    if value is None:
        return "null"
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    return repr(value)[:_MOST_SHOWN]
