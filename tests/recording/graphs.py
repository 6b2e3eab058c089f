"""Two object graphs compared, attribute by attribute; it knows nothing of checkpoints."""

from collections import deque
from collections.abc import Iterator, Mapping
from enum import Enum
from typing import Any

SHARED = ("_codec", "_codecs", "_specs", "_indexes", "_throttle")
"""Attributes that two gateways of one codec share or have alike; they are not walked."""

MADE_WHEN_ASKED = ("_pickers", "speed_step_rpm", "power_step_w")
"""Kept results, which one of both may not have yet."""

Pair = tuple[str, Any, Any]


class DifferenceError(AssertionError):
    """Two graphs are not alike; the text says where."""


def compare(one: Any, other: Any, left_out: tuple[str, ...] = ()) -> None:
    """Raise where both are not alike, or not shared in the same places."""
    pairs: dict[int, int] = {}
    kept: list[Any] = []  # no id is to be given twice meanwhile
    waiting: list[Pair] = [("gateway", one, other)]
    while waiting:
        where, left, right = waiting.pop()
        children = [
            child
            for child in _children(where, left, right)
            if child[0].rpartition(".")[2] not in (*SHARED, *left_out)
        ]
        if not children:
            continue
        kept += [left, right]
        if id(left) not in pairs:
            pairs[id(left)] = id(right)
            waiting += children
        elif pairs[id(left)] != id(right):
            raise DifferenceError(f"{where}: is not shared as the other is")


def _children(where: str, left: Any, right: Any) -> Iterator[Pair]:
    if type(left) is not type(right):
        raise DifferenceError(f"{where}: {left!r} and {right!r}")
    if left is None or isinstance(left, (bool, int, float, str, bytes, Enum, set, frozenset)):
        if left != right:
            raise DifferenceError(f"{where}: {left!r} and {right!r}")
    elif isinstance(left, Mapping):
        yield from _of_keys(where, left, right)
    elif isinstance(left, (list, tuple, deque)):
        yield from _of_items(where, left, right)
    else:
        yield from _of_attributes(where, left, right)


def _of_keys(where: str, left: Any, right: Any) -> Iterator[Pair]:
    if list(left) != list(right):
        raise DifferenceError(f"{where}: keys {list(left)} and {list(right)}")
    for key in left:
        yield f"{where}[{key!r}]", left[key], right[key]


def _of_items(where: str, left: Any, right: Any) -> Iterator[Pair]:
    if len(left) != len(right) or getattr(left, "maxlen", 0) != getattr(right, "maxlen", 0):
        raise DifferenceError(f"{where}: {len(left)} and {len(right)} items")
    for index, (item, its) in enumerate(zip(left, right, strict=True)):
        yield f"{where}[{index}]", item, its


def _of_attributes(where: str, left: Any, right: Any) -> Iterator[Pair]:
    ours, theirs = _attributes(left), _attributes(right)
    if ours.keys() != theirs.keys():
        raise DifferenceError(f"{where}: attributes {sorted(ours.keys() ^ theirs.keys())}")
    for name in ours:
        yield f"{where}.{name}", ours[name], theirs[name]


def _attributes(one: Any) -> dict[str, Any]:
    names = set(getattr(one, "__dict__", ()))
    for kind in type(one).__mro__:
        slots = kind.__dict__.get("__slots__", ())
        names |= {slots} if isinstance(slots, str) else set(slots)
    names -= set(MADE_WHEN_ASKED)
    return {name: getattr(one, name) for name in sorted(names) if hasattr(one, name)}
