"""Definition file dbc/vcu.yaml, read and checked: the protocol and its documentation."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.errors import DataError, MissingInputError
from vcu_gateway.protocol import requirements
from vcu_gateway.protocol.builder import Builder
from vcu_gateway.protocol.definition_model import DefinitionFile, MessageRow
from vcu_gateway.strict_yaml import file_text, parser, validation
from vcu_gateway.strict_yaml.problems import problems


class Definition(NamedTuple):
    """The definition file, read and checked.

    Attributes:
        file: its rows; spec: the protocol as the core knows it.
        rows: the row of each message, by the message's name, and the node that it was built for;
            empty where it is not one for each node.
    """

    file: DefinitionFile
    spec: ProtocolSpec
    rows: Mapping[str, tuple[MessageRow, str]]


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
    return Definition(file, spec, builder.rows)
