"""Models of the rows of dbc/vcu.yaml; whether they fit together is for `definition`."""

import re
from typing import Annotated

from pydantic import BeforeValidator, Field

from vcu_gateway.core.spec import ByteOrder
from vcu_gateway.strict_yaml.validation import Section

_BITS = re.compile(r"B([1-8])(?:-B([1-8])|\[([0-7])(?:-([0-7]))?\])?")
_BYTE_BITS = 8


def _hexadecimal(identifier: object) -> object:
    return f"0x{identifier:08X}" if type(identifier) is int else identifier


# YAML reads a printed identifier as a number, and one with {address} in it as text.
_Identifier = Annotated[str, BeforeValidator(_hexadecimal)]
# YAML has lists, no tuples.
_Pair = Annotated[tuple[str, str], Field(strict=False)]


class SignalRow(Section):
    """One signal; `values` is raw code -> (name, meaning)."""

    bits: str
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    signed: bool = False
    saturated_raw: int | None = None
    values: dict[int, _Pair] = Field(default={})
    source_term: str = ""
    comment: str = ""


class MessageRow(Section):
    """One message, or one for each node of `for_each`.

    `source_ids` is node -> `source_id`, `reserved` is bits -> why.
    """

    id: _Identifier
    for_each: list[str] = Field(default=[])
    source_id: str = ""
    source_ids: dict[str, str] = Field(default={})
    sender: str
    receivers: list[str]
    period_ms: Annotated[int, Field(gt=0)] | None = None
    byte_order: ByteOrder = "little"
    comment: str = ""
    note: str = ""
    use: list[str] = Field(default=[])
    signals: dict[str, SignalRow]
    reserved: dict[str, str] = Field(default={})


class NodeRow(Section):
    """One node; 254 and 255 are no addresses (J1939: none and all)."""

    address: Annotated[int, Field(ge=0, le=0xFD)]
    comment: str = ""


class AliasRow(Section):
    """A further identifier of a message."""

    id: int
    message: str
    comment: str = ""


class DefinitionFile(Section):
    """The whole file; `errata` is number -> (title, decision)."""

    name: str
    version: str
    source: str
    readings: list[str] = Field(default=[])
    bit_rate_default_bit_s: Annotated[int, Field(gt=0)]
    nodes: dict[str, NodeRow]
    aliases: list[AliasRow] = Field(default=[])
    signal_groups: dict[str, dict[str, SignalRow]] = Field(default={})
    messages: dict[str, MessageRow]
    errata: dict[str, _Pair] = Field(default={})


def parse_bits(text: str, byte_order: ByteOrder) -> tuple[int, int] | None:
    """(start bit, length in bits) of "B5", "B1-B2", "B6[2-3]" or "B8[7]"; None otherwise."""
    match = _BITS.fullmatch(text)
    if match is None:
        return None
    first, last, low, high = match.groups()
    first_bit = (int(first) - 1) * _BYTE_BITS
    if low is not None:
        lowest, highest = sorted((int(low), int(high or low)))
        start = lowest if byte_order == "little" else highest
        return first_bit + start, highest - lowest + 1
    count = int(last or first) - int(first) + 1
    if count < 1:
        return None
    start = 0 if byte_order == "little" else _BYTE_BITS - 1
    return first_bit + start, count * _BYTE_BITS
