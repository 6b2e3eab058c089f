"""The protocol as a page that a technician reads: docs/protocol.md."""

from collections.abc import Iterator

from vcu_gateway.core import j1939
from vcu_gateway.core.spec import MessageSpec, SignalSpec
from vcu_gateway.protocol.definition import Definition, MessageNote, SignalNote


def write(definition: Definition) -> str:
    """The page, in Markdown, the same text every time."""
    return "\n".join(_lines(definition)) + "\n"


def _lines(definition: Definition) -> Iterator[str]:
    spec = definition.spec
    yield "# The vehicle's CAN protocol"
    yield ""
    yield "Generated from `dbc/vcu.yaml` by `vcu-gateway dbc`; edit that file, not this page."
    yield ""
    yield (
        "CAN 2.0B, 29-bit identifiers in the manner of J1939, 8 data bytes. The bit rate is not in "
        f"the source: {definition.bit_rate_default_bit_s // 1000} kbit/s unless configured. "
        "B1 to B8 are BYTE1 to BYTE8, bit 0 is a byte's least significant bit. "
        "Physical = raw × factor + offset."
    )
    yield from ("", "## Nodes", "", "| node | address | |", "| --- | --- | --- |")
    for name, address in spec.nodes.items():
        yield _row(name, f"0x{address:02X} ({address})", definition.node_comments[name])
    yield from ("", "## Messages", "")
    yield "| message | identifier | in the source | priority | PGN | from → to | period ms |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for message in spec.messages:
        yield _message_row(message, definition.notes[message.name])
    if spec.aliases:
        yield ""
        for can_id, name in spec.aliases.items():
            comment = definition.alias_comments[can_id]
            yield f"0x{can_id:08X} is received as {name}: {comment}."
    for message in spec.messages:
        yield from _message_section(message, definition.notes[message.name])
    yield from ("", "## Errata and decisions", "")
    for number, (title, decision) in definition.errata.items():
        yield f"- **{number} {title}.** {decision}"


def _row(*cells: str) -> str:
    """A row of a table; a bar inside a cell would end the cell."""
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _message_row(message: MessageSpec, note: MessageNote) -> str:
    identifier = j1939.parse(message.can_id)
    return _row(
        f"[{message.name}](#{message.name.lower()})",
        f"0x{message.can_id:08X}",
        note.source_id or "the same",
        str(identifier.priority),
        f"{identifier.pgn} (0x{identifier.pgn:05X})",
        f"{message.sender} → {', '.join(message.receivers)}",
        str(message.period_ms or "—"),
    )


def _message_section(message: MessageSpec, note: MessageNote) -> Iterator[str]:
    yield from ("", f"## {message.name}", "")
    if message.comment:
        yield from (message.comment + ".", "")
    yield "| signal | bits | factor | offset | unit | range | in the source | meaning |"
    yield "| --- | --- | --- | --- | --- | --- | --- | --- |"
    for signal in message.signals:
        yield _signal_row(signal, note.signals[signal.name])
    for bits, why in note.reserved.items():
        yield _row("(reserved)", bits, "", "", "", "", "", why)


def _signal_row(signal: SignalSpec, note: SignalNote) -> str:
    signedness = " signed" if signal.signed else ""
    meaning = [f"{code} {signal.names[code]}: {text}" for code, text in note.meanings.items()]
    extra = signal.comment.removeprefix(note.source_term).removeprefix("; ")
    return _row(
        signal.name,
        note.bits + signedness,
        _number(signal.factor),
        _number(signal.offset),
        signal.unit,
        f"{_number(signal.minimum)}…{_number(signal.maximum)}",
        note.source_term,
        "<br>".join([*meaning, *([extra] if extra else [])]),
    )


def _number(number: float) -> str:
    return f"{number:.10g}".replace("-", "−")
