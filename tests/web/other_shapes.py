"""An answer with each of its fields missing, null and of another type."""

import copy
from collections.abc import Iterator
from typing import Any, NamedTuple

_OTHERS: tuple[Any, ...] = (None, "text", 1e300, True, [], {}, [None], {"x": None})


class Variant(NamedTuple):
    """One changed answer: where, how, and the whole answer."""

    where: str
    how: str
    answer: Any

    def __str__(self) -> str:
        return f"{self.where} {self.how}"


def variants(answer: Any) -> Iterator[Variant]:
    """Every field in turn; of a list its first item stands for all."""
    for path in _paths(answer):
        changed = copy.deepcopy(answer)
        holder = _at(changed, path[:-1])
        if isinstance(holder, dict):
            del holder[path[-1]]
            yield Variant(_text(path), "missing", changed)
        for other in _OTHERS:
            if type(other) is type(_at(answer, path)):
                continue
            changed = copy.deepcopy(answer)
            _at(changed, path[:-1])[path[-1]] = copy.deepcopy(other)
            yield Variant(_text(path), repr(other), changed)
    for other in _OTHERS:
        yield Variant("", repr(other), copy.deepcopy(other))


def _paths(value: Any, before: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    items = (
        value.items()
        if isinstance(value, dict)
        else enumerate(value[:1])
        if isinstance(value, list)
        else ()
    )
    for key, item in items:
        yield (*before, key)
        yield from _paths(item, (*before, key))


def _at(value: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        value = value[key]
    return value


def _text(path: tuple[Any, ...]) -> str:
    return ".".join(map(str, path))
