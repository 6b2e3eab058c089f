"""YAML with the line of every key, so that an error can say where."""

from collections.abc import Sequence
from typing import Any

import yaml

Path = tuple[str | int, ...]


class LineMap:
    """Line of each key and item, by its path in the document."""

    def __init__(self) -> None:
        self._lines: dict[Path, int] = {}

    def add(self, path: Path, line: int) -> None:
        """Remember a line, counted from 1."""
        self._lines[path] = line

    def line(self, path: Sequence[str | int]) -> int | None:
        """The line of the longest known beginning of this path, or None."""
        known = tuple(path)
        while known and known not in self._lines:
            known = known[:-1]
        return self._lines.get(known)

    def where(self, file: str, path: Sequence[str | int]) -> str:
        """file:line, or the file alone where the line is not known."""
        line = self.line(path)
        return file if line is None else f"{file}:{line}"


class DuplicateKeyError(yaml.YAMLError):
    """The same key twice in one mapping: the file's author meant one of them."""


class _Loader(yaml.SafeLoader):
    """SafeLoader that keeps lines; a cycle of anchors or a duplicate key is an error."""


def load_with_lines(text: str) -> tuple[Any, LineMap]:
    """Parse one YAML document; yaml.YAMLError where it is none or has a key twice."""
    lines = LineMap()
    loader = _Loader(text)
    try:
        node = loader.get_single_node()
        if node is None:
            return None, lines
        try:
            _walk(node, (), lines)
            return loader.construct_document(node), lines
        except RecursionError as error:
            raise yaml.YAMLError("nested too deeply") from error
    finally:
        loader.dispose()


def _walk(node: yaml.Node, path: Path, lines: LineMap) -> None:
    if isinstance(node, yaml.MappingNode):
        seen: set[str] = set()
        for key, value in node.value:
            name = str(key.value)
            if name in seen:
                line = key.start_mark.line + 1
                raise DuplicateKeyError(f"line {line}: the key {name!r} stands twice")
            seen.add(name)
            lines.add((*path, name), key.start_mark.line + 1)
            _walk(value, (*path, name), lines)
    elif isinstance(node, yaml.SequenceNode):
        for index, item in enumerate(node.value):
            lines.add((*path, index), item.start_mark.line + 1)
            _walk(item, (*path, index), lines)
