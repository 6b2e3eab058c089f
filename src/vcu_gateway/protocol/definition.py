"""Definition file dbc/vcu.yaml, read, checked and built: the protocol and its documentation."""

import dataclasses
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.core import j1939
from vcu_gateway.core.spec import ByteOrder, MessageSpec, ProtocolSpec, SignalSpec
from vcu_gateway.errors import DataError, MissingInputError, Problem
from vcu_gateway.protocol import dbc
from vcu_gateway.protocol.definition_model import DefinitionFile, MessageRow, SignalRow, parse_bits
from vcu_gateway.strict_yaml import file_text, parser, validation
from vcu_gateway.strict_yaml.file_text import LineMap, problems

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,31}")
_NO_IDENTIFIER = -1
_NO_NAME = "is no DBC name (letters, digits, _, at most 32)"

_At = tuple[str | int, ...]


class Builder:
    """Turns rows into the model.

    Attributes:
        problems: each bad row once, with its name and line.
        rows: of the messages that were built, as in `Definition`.
    """

    def __init__(self, file: DefinitionFile, where: str, lines: LineMap) -> None:
        self._file = file
        self._where = where
        self._lines = lines
        self._addresses = {name: node.address for name, node in file.nodes.items()}
        self.problems: list[Problem] = []
        self.rows: dict[str, tuple[MessageRow, str]] = {}
        self._keys: dict[str, str] = {}

    def build(self) -> ProtocolSpec:
        """The protocol; to be used only if `problems` stays empty."""
        self._check_nodes()
        messages: list[MessageSpec] = []
        for key, row in self._file.messages.items():
            self._check_source_ids(key, row)
            for node, message in self._instances(key, row):
                self._check_unique(message, messages, key)
                messages.append(message)
                self.rows[message.name] = row, node
                self._keys[message.name] = key
        return ProtocolSpec(tuple(messages), self._addresses, self._aliases(messages))

    def where(self, message: str, signal: str) -> str:
        """File and line of a signal, or else of its message or of all of them."""
        if message not in self._keys:
            return self._lines.where(self._where, ("messages",))
        (row, _), key = self.rows[message], self._keys[message]
        for group in row.use:
            if signal in self._file.signal_groups[group]:
                return self._lines.where(self._where, ("signal_groups", group, signal))
        at = ("signals", signal) if signal else ()
        return self._lines.where(self._where, ("messages", key, *at))

    def _refuse(self, what: str, *row: str | int) -> None:
        name = ".".join(map(str, row[1:]))
        problem = Problem(f"{name}: {what}", self._lines.where(self._where, row))
        # A row that stands for several messages is still wrong once.
        if problem not in self.problems:
            self.problems.append(problem)

    def _check_nodes(self) -> None:
        owners: dict[int, str] = {}
        for name, address in self._addresses.items():
            if not _NAME.fullmatch(name):
                self._refuse(_NO_NAME, "nodes", name)
            if address in owners:
                what = f"0x{address:02X} is taken by {owners[address]}"
                self._refuse(what, "nodes", name, "address")
            owners.setdefault(address, name)

    def _check_source_ids(self, key: str, row: MessageRow) -> None:
        if any(node not in self._addresses for node in row.for_each):
            return  # that is reported already, and this follows from it
        for node in row.source_ids:
            if node not in row.for_each:
                self._refuse(f"{node} is not in for_each", "messages", key, "source_ids", node)

    def _instances(self, key: str, row: MessageRow) -> Iterator[tuple[str, MessageSpec]]:
        for node in row.for_each or [""]:
            if node and node not in self._addresses:
                self._refuse(f"unknown node {node}", "messages", key, "for_each")
                continue
            yield node, self._message(key, row, node)

    def _message(self, key: str, row: MessageRow, node: str) -> MessageSpec:
        name = key.replace("{node}", node)
        if not _NAME.fullmatch(name):
            self._refuse(_NO_NAME, "messages", key)
        can_id = self._identifier(key, row, node)
        message = MessageSpec(
            name=name,
            can_id=can_id,
            sender=row.sender.replace("{node}", node),
            receivers=tuple(party.replace("{node}", node) for party in row.receivers),
            period_ms=row.period_ms,
            signals=tuple(self._signals(key, row)),
            comment=row.comment,
        )
        if self._check_parties(message, key) and can_id != _NO_IDENTIFIER:
            self._check_addresses(message, key)
        self._check_overlap(message.signals, key)
        self._check_reserved(message, key, row)
        return message

    def _identifier(self, key: str, row: MessageRow, node: str) -> int:
        address = f"{self._addresses[node]:02X}" if node else ""
        try:
            can_id = int(row.id.replace("{address}", address), 16)
        except ValueError:
            self._refuse(f"{row.id!r} is no hexadecimal number", "messages", key, "id")
            return _NO_IDENTIFIER
        if not 0 <= can_id <= j1939.ID_MASK:
            self._refuse(f"{row.id} does not fit 29 bits", "messages", key, "id")
            return _NO_IDENTIFIER
        return can_id

    def _check_parties(self, message: MessageSpec, key: str) -> bool:
        parties = dict.fromkeys(message.receivers, "receivers") | {message.sender: "sender"}
        unknown = {party: at for party, at in parties.items() if party not in self._addresses}
        for party, at in unknown.items():
            self._refuse(f"unknown node {party}", "messages", key, at)
        return not unknown

    def _check_addresses(self, message: MessageSpec, key: str) -> None:
        identifier = j1939.parse(message.can_id)
        if identifier.source_address != self._addresses[message.sender]:
            what = f"0x{message.can_id:08X} does not end in the address of {message.sender}"
            self._refuse(what, "messages", key, "id")
        addressed = {self._addresses[party] for party in message.receivers}
        if identifier.destination_address not in {None, j1939.GLOBAL_ADDRESS, *addressed}:
            what = f"0x{message.can_id:08X} is not addressed to {', '.join(message.receivers)}"
            self._refuse(what, "messages", key, "id")

    def _signals(self, key: str, row: MessageRow) -> Iterator[SignalSpec]:
        seen: set[str] = set()
        for name, signal, at in self._signal_rows(key, row):
            if name in seen:
                self._refuse(f"the name {name} stands twice in this message", *at)
            seen.add(name)
            if not _NAME.fullmatch(name):
                self._refuse(_NO_NAME, *at)
            if built := self._signal(name, signal, row.byte_order, at):
                yield built

    def _signal_rows(self, key: str, row: MessageRow) -> Iterator[tuple[str, SignalRow, _At]]:
        for group in row.use:
            if group not in self._file.signal_groups:
                self._refuse(f"unknown signal group {group}", "messages", key, "use")
            for name, signal in self._file.signal_groups.get(group, {}).items():
                yield name, signal, ("signal_groups", group, name)
        for name, signal in row.signals.items():
            yield name, signal, ("messages", key, "signals", name)

    def _signal(
        self, name: str, row: SignalRow, byte_order: ByteOrder, at: _At
    ) -> SignalSpec | None:
        place = parse_bits(row.bits, byte_order)
        if place is None:
            self._refuse(_no_bits(row.bits), *at, "bits")
            return None
        if row.factor == 0:
            self._refuse("a factor of 0 loses the value", *at, "factor")
            return None
        bits = SignalSpec(name, *place, 0, 0, byte_order, row.signed, row.factor, row.offset)
        lowest, highest = sorted(
            raw * row.factor + row.offset for raw in (bits.raw_lowest, bits.raw_highest)
        )
        signal = dataclasses.replace(
            bits,
            minimum=lowest if row.minimum is None else row.minimum,
            maximum=highest if row.maximum is None else row.maximum,
            unit=row.unit,
            names={code: named[0] for code, named in row.values.items()},
            saturated_raw=row.saturated_raw,
            comment="; ".join(text for text in (row.source_term, row.comment) if text),
        )
        self._check_range(signal, lowest, highest, at)
        self._check_codes(signal, at)
        return signal

    def _check_range(self, signal: SignalSpec, lowest: float, highest: float, at: _At) -> None:
        half_a_bit = abs(signal.factor) / 2
        if not math.isfinite(highest - lowest):
            self._refuse("the factor is too large", *at, "factor")
            return
        for key, limit in (("minimum", signal.minimum), ("maximum", signal.maximum)):
            if not lowest - half_a_bit <= limit <= highest + half_a_bit:
                what = f"{limit:g} does not fit the bits, which hold {lowest:g}..{highest:g}"
                self._refuse(what, *at, key)
                return
        if signal.minimum > signal.maximum or signal.raw_minimum > signal.raw_maximum:
            what = f"no code lies in the range {signal.minimum:g}..{signal.maximum:g}"
            self._refuse(what, *at, "minimum")

    def _check_codes(self, signal: SignalSpec, at: _At) -> None:
        rows: list[tuple[_At, int]] = [(("values", code), code) for code in signal.names]
        if signal.saturated_raw is not None:
            rows.append((("saturated_raw",), signal.saturated_raw))
        for key, code in rows:
            if not signal.raw_lowest <= code <= signal.raw_highest:
                held = f"{signal.raw_lowest}..{signal.raw_highest}"
                self._refuse(f"{code} does not fit the bits, which hold {held}", *at, *key)

    def _check_overlap(self, signals: tuple[SignalSpec, ...], key: str) -> None:
        owner: dict[int, str] = {}
        for signal in signals:
            bits = signal.bit_positions()
            if shared := [bit for bit in bits if bit in owner]:
                bit = min(shared)
                what = f"overlaps {owner[bit]} at B{bit // 8 + 1}[{bit % 8}]"
                self._refuse(what, "messages", key, "signals", signal.name)
            owner |= dict.fromkeys(bits, signal.name)

    def _check_reserved(self, message: MessageSpec, key: str, row: MessageRow) -> None:
        for text in row.reserved:
            place = parse_bits(text, "little")
            if place is None:
                self._refuse(_no_bits(text), "messages", key, "reserved", text)
                continue
            reserved = set(range(place[0], sum(place)))
            for signal in message.signals:
                if reserved & set(signal.bit_positions()):
                    what = f"lies on {text}, which `reserved` keeps free in 0x{message.can_id:08X}"
                    self._refuse(what, "messages", key, "signals", signal.name)

    def _check_unique(self, message: MessageSpec, others: list[MessageSpec], key: str) -> None:
        for other in others:
            if other.name == message.name:
                self._refuse(f"the name {message.name} stands twice", "messages", key)
            if message.can_id == _NO_IDENTIFIER:
                continue
            if j1939.match_key(other.can_id) == j1939.match_key(message.can_id):
                taken = f"0x{message.can_id:08X} is taken by {other.name}"
                self._refuse(f"{taken} (priority does not count)", "messages", key, "id")

    def _aliases(self, messages: list[MessageSpec]) -> dict[int, str]:
        names = {message.name for message in messages}
        taken = {j1939.match_key(message.can_id): message.name for message in messages}
        aliases: dict[int, str] = {}
        for index, alias in enumerate(self._file.aliases):
            key = j1939.match_key(alias.id)
            if alias.message not in names:
                self._refuse(f"unknown message {alias.message}", "aliases", index)
            if not 0 <= alias.id <= j1939.ID_MASK:
                self._refuse(f"id 0x{alias.id:08X} does not fit 29 bits", "aliases", index)
            elif key in taken:
                self._refuse(f"id 0x{alias.id:08X} is taken by {taken[key]}", "aliases", index)
            taken.setdefault(key, alias.message)
            aliases[alias.id] = alias.message
        return aliases


def _no_bits(text: str) -> str:
    return f"{text!r} is not of the form B5, B1-B2, B6[2-3] or B8[7]"


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
    if found := builder.problems or dbc.unmet(spec, builder.where):
        raise DataError(*found)
    return Definition(file, spec, builder.rows)
