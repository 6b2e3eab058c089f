"""Definition file dbc/vcu.yaml, read and checked: the protocol and its documentation."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.errors import DataError, MissingInputError
from vcu_gateway.protocol import requirements
from vcu_gateway.protocol.builder import Builder
from vcu_gateway.protocol.definition_model import DefinitionFile, MessageRow, SignalRow
from vcu_gateway.strict_yaml import file_text, parser, validation
from vcu_gateway.strict_yaml.problems import problems


@dataclass(frozen=True)
class SignalNote:
    """Documentation of a signal beyond its numbers."""

    bits: str
    source_term: str
    meanings: Mapping[int, str]


@dataclass(frozen=True)
class MessageNote:
    """Documentation of a message beyond its numbers."""

    source_id: str
    note: str
    signals: Mapping[str, SignalNote]
    reserved: Mapping[str, str]


@dataclass(frozen=True)
class Definition:
    """The definition file, read and checked.

    Attributes:
        source: what the protocol was read from; readings: how that is to be read.
        spec: the protocol as the core knows it.
        notes: per message, for the documentation.
        errata: number -> (title, decision).
    """

    name: str
    version: str
    source: str
    readings: tuple[str, ...]
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
    return parse(file_text.read(path, MissingInputError), str(path))


def parse(text: str, where: str = "definition") -> Definition:
    """As `load`, from text; `where` is the file name that errors show."""
    document = parser.read(text)
    file, findings = validation.validated_document(DefinitionFile, document)
    if file is None or findings:
        raise DataError(*problems(findings, where, document.lines))
    builder = Builder(file, where, document.lines)
    spec = builder.build()
    if found := builder.problems or requirements.unmet(spec, builder.where):
        raise DataError(*found)
    return Definition(
        name=file.name,
        version=file.version,
        source=file.source,
        readings=tuple(file.readings),
        bit_rate_default_bit_s=file.bit_rate_default_bit_s,
        spec=spec,
        notes={name: _note(file, row, node) for name, (row, node) in builder.rows.items()},
        node_comments={name: node.comment for name, node in file.nodes.items()},
        alias_comments={alias.id: alias.comment for alias in file.aliases},
        errata=file.errata,
    )


def _note(file: DefinitionFile, row: MessageRow, node: str) -> MessageNote:
    signals: dict[str, SignalRow] = {}
    for group in row.use:
        signals |= file.signal_groups[group]
    signals |= row.signals
    return MessageNote(
        source_id=row.source_ids.get(node, row.source_id),
        note=row.note,
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
