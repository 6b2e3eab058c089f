"""dbc/vcu.yaml, read and checked: the protocol and what the documentation says of it."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import yaml
from pydantic import ValidationError

from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.errors import DataError, MissingInputError, Problem
from vcu_gateway.protocol.builder import Builder
from vcu_gateway.protocol.definition_model import DefinitionFile, MessageRow, SignalRow
from vcu_gateway.strict_yaml.lines import LineMap, load_with_lines

_PLAINER = {
    "extra_forbidden": "unknown key",
    "missing": "this key is missing",
    "model_type": "is no mapping",
}
"""What pydantic calls a problem -> what we call it."""


@dataclass(frozen=True)
class SignalNote:
    """What the documentation says of a signal beyond its numbers."""

    bits: str
    source_term: str
    meanings: Mapping[int, str]


@dataclass(frozen=True)
class MessageNote:
    """What the documentation says of a message beyond its numbers."""

    source_id: str
    signals: Mapping[str, SignalNote]
    reserved: Mapping[str, str]


@dataclass(frozen=True)
class Definition:
    """The definition file, read and checked.

    Attributes:
        spec: the protocol as the core knows it.
        notes: per message, for the documentation.
        errata: number -> (title, decision).
    """

    name: str
    version: str
    source: str
    bit_rate_default_bit_s: int
    spec: ProtocolSpec
    notes: Mapping[str, MessageNote]
    node_comments: Mapping[str, str]
    alias_comments: Mapping[int, str]
    errata: Mapping[str, tuple[str, str]]


def load(path: Path) -> Definition:
    """Read a definition file.

    Raises MissingInputError where it cannot be read, DataError naming every bad row.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise MissingInputError(Problem(f"cannot be read: {error}", str(path))) from error
    return parse(text, str(path))


def parse(text: str, where: str = "definition") -> Definition:
    """As `load`, from text; `where` is the file name that errors show."""
    try:
        content, lines = load_with_lines(text)
    except (yaml.YAMLError, ValueError) as error:
        raise DataError(_yaml_problem(error, where)) from error
    try:
        file = DefinitionFile.model_validate(content)
    except ValidationError as error:
        raise DataError(*_shape_problems(error, where, lines)) from error
    builder = Builder(file, where, lines)
    spec = builder.build()
    if builder.problems:
        raise DataError(*builder.problems)
    return Definition(
        name=file.name,
        version=file.version,
        source=file.source,
        bit_rate_default_bit_s=file.bit_rate_default_bit_s,
        spec=spec,
        notes={name: _note(file, row) for name, row in builder.rows.items()},
        node_comments={name: node.comment for name, node in file.nodes.items()},
        alias_comments={alias.id: alias.comment for alias in file.aliases},
        errata=file.errata,
    )


def _yaml_problem(error: Exception, where: str) -> Problem:
    lines = re.findall(r"line (\d+)", str(error))
    what = getattr(error, "problem", None) or " ".join(str(error).split())
    return Problem(f"is not YAML: {what}", f"{where}:{lines[-1]}" if lines else where)


def _shape_problems(error: ValidationError, where: str, lines: LineMap) -> Iterator[Problem]:
    for item in error.errors():
        path = tuple(item["loc"])
        row = ".".join(map(str, path)) or "the file"
        what = _PLAINER.get(item["type"], item["msg"])
        yield Problem(f"{row}: {what}", lines.where(where, path))


def _note(file: DefinitionFile, row: MessageRow) -> MessageNote:
    signals: dict[str, SignalRow] = {}
    for group in row.use:
        signals |= file.signal_groups[group]
    signals |= row.signals
    return MessageNote(
        source_id=row.source_id,
        signals={
            name: SignalNote(
                signal.bits,
                signal.source_term,
                {code: meaning for code, (_, meaning) in signal.values.items()},
            )
            for name, signal in signals.items()
        },
        reserved=row.reserved,
    )
