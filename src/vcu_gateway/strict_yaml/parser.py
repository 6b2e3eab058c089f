"""YAML parser: text -> plain values, with the line of every key.

Stricter than YAML, so that a file means what a person reads in it: a key stands once, `yes`
and `010` are text (which no number or switch accepts), and there are no aliases, tags, merges
or second documents. A file of any contents is read in bounded memory and depth.
"""

import math
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

from vcu_gateway.lean_imports import hidden

# Its parser in C is not used here, and takes 0.8 MB.
with hidden("yaml._yaml"):
    import yaml

from vcu_gateway.strict_yaml.file_text import FileProblem, LineMap, shown
from vcu_gateway.strict_yaml.file_text import KeyPath as Path

_MAX_DEPTH = 8

_WORDS: dict[str, bool | float | None] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
    **dict.fromkeys((".inf", "+.inf", ".Inf", "+.Inf", ".INF", "+.INF"), math.inf),
    **dict.fromkeys(("-.inf", "-.Inf", "-.INF"), -math.inf),
    **dict.fromkeys((".nan", ".NaN", ".NAN"), math.nan),
}
_WHOLE = re.compile(r"[-+]?(0|[1-9][0-9]{0,29})")
_HEXADECIMAL = re.compile(r"0x[0-9a-fA-F]{1,16}")
_DECIMAL = re.compile(r"[-+]?(\.[0-9]+|(0|[1-9][0-9]{0,29})(\.[0-9]*)?)([eE][-+]?[0-9]{1,3})?")

_SYNTAX_REMEDIES = {
    r"character '\t'": "indent with spaces, not with tabs",
    "mapping values are not allowed": "check the indentation, and quote text that holds a colon",
    "could not find expected ':'": "write `key: value`, with a space after the colon",
}


class YamlDocument(NamedTuple):
    """A parsed text; `value` is None where it is empty, and where it is no YAML."""

    value: Any
    lines: LineMap
    findings: tuple[FileProblem, ...]
    is_yaml: bool


def read(text: str) -> YamlDocument:
    """Parse one document; problems are in its findings, nothing is raised."""
    reader = _Reader(text)
    try:
        value, is_yaml = reader.document(), True
    except _NotReadableError as error:
        reader.findings.append(error.finding)
        value, is_yaml = None, False
    return YamlDocument(value, reader.lines, tuple(reader.findings), is_yaml)


class _NotReadableError(Exception):
    """From here on the text says nothing reliable."""

    def __init__(self, what: str, remedy: str = "", line: int | None = None) -> None:
        super().__init__(what)
        self.finding = FileProblem((), what, remedy, line)


def _events(text: str) -> Iterator[Any]:
    """YAML's events; whatever the library raises becomes one sentence with a line."""
    line = 1
    try:
        for event in yaml.parse(text, Loader=yaml.BaseLoader):
            line = _line(event)
            yield event
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise _NotReadableError(f"holds {_code_point(text[error.position])}", "", line) from error
    except yaml.MarkedYAMLError as error:
        raise _syntax_error(error) from error
    except (ValueError, OverflowError) as error:  # an escape such as "\UFFFFFFFF"
        raise _NotReadableError("is not valid YAML: no such character", "", line) from error


def _syntax_error(error: yaml.MarkedYAMLError) -> _NotReadableError:
    # A word that never ends is wrong where it begins, a structure where it breaks.
    begins = str(error.context).startswith("while scanning")
    mark = (begins and error.context_mark) or error.problem_mark
    line = None if mark is None else mark.line + 1
    what = ", ".join(" ".join(part.split()) for part in (error.context, error.problem) if part)
    remedy = next((remedy for sign, remedy in _SYNTAX_REMEDIES.items() if sign in what), "")
    return _NotReadableError(f"is not valid YAML: {what}", remedy, line)


class _Reader:
    """Builds values from events, a level of the document a call."""

    def __init__(self, text: str) -> None:
        self._events = _events(text)
        self.lines = LineMap()
        self.findings: list[FileProblem] = []

    def document(self) -> Any:
        next(self._events)  # the stream begins
        if isinstance(next(self._events), yaml.StreamEndEvent):
            return None
        value = self._value(next(self._events), ())
        next(self._events)  # the document ends
        after = next(self._events)
        if isinstance(after, yaml.DocumentStartEvent):
            what = "a second document begins here (---); only one is read"
            raise _NotReadableError(what, "", _line(after))
        return value

    def _value(self, event: Any, path: Path) -> Any:
        if isinstance(event, yaml.AliasEvent):
            what = f"aliases (*{event.anchor}) are not read here"
            raise _NotReadableError(what, "write the value out", _line(event))
        if event.tag is not None:
            self._find(path, "tags such as !!str are not read here", event, "remove the tag")
        if isinstance(event, yaml.ScalarEvent):
            return self._scalar(event, path)
        if len(path) >= _MAX_DEPTH:
            raise _NotReadableError("is nested too deeply", "", _line(event))
        is_mapping = isinstance(event, yaml.MappingStartEvent)
        return self._mapping(path) if is_mapping else self._sequence(path)

    def _scalar(self, event: Any, path: Path) -> Any:
        text: str = event.value
        hidden = next((character for character in text if not character.isprintable()), None)
        if hidden is not None:
            self._find(path, f"holds {_code_point(hidden)}", event)
        return text if event.style else plain(text)

    def _mapping(self, path: Path) -> dict[str | int, Any]:
        content: dict[str | int, Any] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            key = self._value(event, path)
            if self._is_new_key(key, path, content, event):
                self.lines[*path, key] = _line(event)
                content[key] = self._value(next(self._events), (*path, key))
            else:
                self._skip()
        return content

    def _is_new_key(self, key: Any, path: Path, content: dict[str | int, Any], event: Any) -> bool:
        if isinstance(key, bool) or not isinstance(key, str | int):
            self._find(path, f"a key must be a word or a whole number, not {shown(key)}", event)
            return False
        if isinstance(key, str) and not key.isprintable():
            return False  # a finding already
        if key in content:
            at = (*path, key)
            what = f"duplicate key, first defined in line {self.lines.line(at)}"
            self._find(at, what, event, "remove one of them")
            return False
        return True

    def _find(self, path: Path, what: str, event: Any, remedy: str = "") -> None:
        self.findings.append(FileProblem(path, what, remedy, _line(event)))

    def _skip(self) -> None:
        depth = 0
        while True:
            event = next(self._events)
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            if depth == 0:
                return

    def _sequence(self, path: Path) -> list[Any]:
        content: list[Any] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            at = (*path, len(content))
            self.lines[at] = _line(event)
            content.append(self._value(event, at))
        return content


def _line(event: Any) -> int:
    return int(event.start_mark.line) + 1


def plain(text: str) -> Any:
    """Value of an unquoted word; the word itself where it is text."""
    if text in _WORDS:
        return _WORDS[text]
    if _WHOLE.fullmatch(text):
        return int(text)
    if _HEXADECIMAL.fullmatch(text):
        return int(text, 16)
    return float(text) if _DECIMAL.fullmatch(text) else text


def _code_point(character: str) -> str:
    return f"the character U+{ord(character):04X}, which cannot be read"
