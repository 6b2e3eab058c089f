"""Every event that the program can log, read from its source: by syntax, not by text.

What cannot be told from the source is an error, so that no event is missed in silence.
"""

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

SOURCE = Path(__file__).parents[2] / "src" / "vcu_gateway"
LEVELS = ("debug", "info", "warning", "error", "critical", "exception")

Function = ast.FunctionDef | ast.AsyncFunctionDef


class SourceEvent(NamedTuple):
    """One event: every severity that its source could mean, and the names of its fields."""

    name: str
    severities: frozenset[str]
    fields: frozenset[str]
    where: str


class UnclearError(Exception):
    """The source does not say it."""


class _Place(NamedTuple):
    """A call, and the function that it stands in."""

    call: ast.Call
    function: Function | None


class Module:
    """One file of the program."""

    def __init__(self, text: str, where: str) -> None:
        self.where = where
        self._tree = ast.parse(text)
        self._places = list(self._walk(self._tree, None))

    def _walk(self, node: ast.AST, function: Function | None) -> Iterator[_Place]:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.Call):
                yield _Place(child, function)
            inner = child if isinstance(child, Function) else function
            yield from self._walk(child, inner)

    def told(self) -> Iterator[SourceEvent]:
        """What this file can tell."""
        for place in self._places:
            if self._is_event(place.call):
                yield from self._of_event(place, place.call.args[0], [])
            elif level := self._level(place.call):
                yield self._of_log(place.call, level)

    def _is_event(self, call: ast.Call) -> bool:
        """An event of the core; threading.Event and asyncio.Event are attributes."""
        named = isinstance(call.func, ast.Name) and call.func.id == "Event"
        return (named and bool(call.args)) or (
            isinstance(call.func, ast.Attribute)
            and call.func.attr == "Event"
            and ast.unparse(call.func.value) not in ("threading", "asyncio")
        )

    @staticmethod
    def _level(call: ast.Call) -> str:
        func = call.func
        if not isinstance(func, ast.Attribute) or func.attr not in LEVELS:
            return ""
        return func.attr if ast.unparse(func.value) in ("log", "log.log") else ""

    def _of_log(self, call: ast.Call, level: str) -> SourceEvent:
        if any(keyword.arg is None for keyword in call.keywords):
            raise self._unclear(call)
        names = frozenset(str(keyword.arg) for keyword in call.keywords)
        return SourceEvent(self._text(call.args[0]), frozenset({level}), names, self._at(call))

    def _of_event(
        self, place: _Place, name: ast.expr, callers: list[_Place]
    ) -> Iterator[SourceEvent]:
        """`callers` lead to `place`, the nearest last: their arguments may hold the name."""
        nearest = callers[-1] if callers else place
        if isinstance(name, ast.Constant):
            yield self._whole(place, self._text(name), callers)
            return
        if not (isinstance(name, ast.Name) and nearest.function is not None):
            raise self._unclear(nearest.call)
        found = list(self._calls_of(nearest.function))
        if not found:
            raise self._unclear(nearest.call)
        for caller in found:
            given = self._argument(caller.call, nearest.function, name.id)
            if given is None:
                raise self._unclear(caller.call)
            yield from self._of_event(place, given, [*callers, caller])

    def _whole(self, place: _Place, name: str, callers: list[_Place]) -> SourceEvent:
        severity, fields = place.call.args[1], (place.call.args[2:] or [None])[0]
        chain = [place, *callers]
        names = frozenset(self._fields(fields, chain)) if fields is not None else frozenset()
        where = self._at(chain[-1].call)
        return SourceEvent(name, frozenset(self._severities(severity, place)), names, where)

    # Fields.

    def _fields(self, value: ast.expr, chain: list[_Place]) -> Iterator[str]:
        if isinstance(value, ast.Dict):
            for key, inner in zip(value.keys, value.values, strict=True):
                yield from self._fields(inner, chain) if key is None else [self._text(key)]
        elif isinstance(value, ast.Name):
            yield from self._fields_of_name(value, chain)
        else:
            raise self._unclear(value)

    def _fields_of_name(self, name: ast.Name, chain: list[_Place]) -> Iterator[str]:
        place, callers = chain[0], chain[1:]
        assigned = self._assigned(name.id, place)
        if assigned is not None:
            yield from self._fields(assigned, chain)
            return
        if place.function is None or not callers:
            raise self._unclear(name)
        spread = place.function.args.kwarg
        if spread is not None and spread.arg == name.id:
            yield from (str(keyword.arg) for keyword in callers[0].call.keywords)
            return
        given = self._argument(callers[0].call, place.function, name.id)
        if given is None:
            raise self._unclear(name)
        yield from self._fields(given, callers)

    def _assigned(self, name: str, place: _Place) -> ast.expr | None:
        """What the name was given last before the call, in its function."""
        found: list[tuple[int, ast.expr]] = []
        for node in ast.walk(place.function or self._tree):
            if not isinstance(node, ast.Assign | ast.AnnAssign):
                continue
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            is_it = any(isinstance(one, ast.Name) and one.id == name for one in targets)
            if is_it and node.value is not None and node.lineno <= place.call.lineno:
                found.append((node.lineno, node.value))
        return max(found, key=lambda one: one[0])[1] if found else None

    # Severities.

    def _severities(self, value: ast.AST, place: _Place) -> Iterator[str]:
        """Every Severity that stands in the expression, or in what its names mean here."""
        for node in ast.walk(value):
            if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "Severity":
                yield node.attr.lower()
            elif isinstance(node, ast.Name) and node.id != "Severity":
                yield from self._severities_of_name(node.id, place)

    def _severities_of_name(self, name: str, place: _Place) -> Iterator[str]:
        local = self._assigned(name, place)
        if local is not None:
            yield from self._severities(local, place)
        for node in self._tree.body:
            is_function = isinstance(node, Function) and node.name == name
            if is_function or (
                isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name
            ):
                inner = ast.walk(node)
                words = (ast.unparse(one) for one in inner if isinstance(one, ast.Attribute))
                yield from (
                    word.removeprefix("Severity.").lower()
                    for word in words
                    if word.startswith("Severity.")
                )

    # Calls.

    def _calls_of(self, function: Function) -> Iterator[_Place]:
        for place in self._places:
            func = place.call.func
            called = func.attr if isinstance(func, ast.Attribute) else ast.unparse(func)
            if called == function.name:
                yield place

    @staticmethod
    def _argument(call: ast.Call, function: Function, name: str) -> ast.expr | None:
        """What a call gives for a parameter; None where that cannot be told."""
        names = [one.arg for one in function.args.args if one.arg != "self"]
        by_name = [one.value for one in call.keywords if one.arg == name]
        if by_name:
            return by_name[0]
        position = names.index(name) if name in names else len(call.args)
        return call.args[position] if position < len(call.args) else None

    def _text(self, node: ast.expr) -> str:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return node.value
        raise self._unclear(node)

    def _at(self, node: ast.expr) -> str:
        return f"{self.where}:{node.lineno}"

    def _unclear(self, node: ast.expr) -> UnclearError:
        return UnclearError(f"{self._at(node)}: which event? {ast.unparse(node)}")


def of_the_program() -> list[SourceEvent]:
    """Every event of every file; recorded drives hold events, and have none of their own."""
    files = sorted(path for path in SOURCE.rglob("*.py") if path.parent.name != "recording")
    return [
        told
        for path in files
        for told in Module(path.read_text("utf-8"), str(path.relative_to(SOURCE))).told()
    ]
