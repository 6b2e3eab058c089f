"""Protocol page, docs/protocol.md: the specification, for a technician."""

from collections.abc import Iterator

from vcu_gateway.core import j1939
from vcu_gateway.core.spec import MessageSpec, ProtocolSpec, SignalSpec
from vcu_gateway.protocol.definition import Definition
from vcu_gateway.protocol.definition_model import DefinitionFile, MessageRow, SignalRow

_MAY_CHANGE = (
    (
        "messages",
        "further ones, from any other node to VCU, with a signal at least",
        "the names of those above",
    ),
    (
        "signals",
        (
            "further ones on free bits of a message that is received; where a device uses "
            "bits of `reserved`, take them out of there"
        ),
        "the names of those above, and the unit of a quantity",
    ),
    (
        "identifiers",
        "all, also of the commands, and the nodes' addresses",
        "29 bits that end in the sender's address",
    ),
    (
        "layout of what is received",
        "bits, byte order, factor, offset, range",
        "of what the rules read as a code: how many codes its bits hold, factor 1, offset 0",
    ),
    (
        "periods",
        "those of further messages",
        (
            "those above: where a device sends at another rate, `freshness` in the "
            "configuration says when its message is too old"
        ),
    ),
    (
        "commands",
        "their identifiers",
        (
            "PCU1 and PCU2, one command each and nothing else that VCU sends; every bit, "
            "factor and range; 50 ms"
        ),
    ),
    (
        "texts",
        "comments, names of codes, notes, the usual bit rate",
        "what a code means: [safety](safety.md) judges its number",
    ),
)


def write(definition: Definition) -> str:
    """The page, in Markdown, the same text every time."""
    return "\n".join(_lines(definition)) + "\n"


def _lines(definition: Definition) -> Iterator[str]:
    file, spec, rows = definition
    yield "# The vehicle's CAN protocol"
    yield ""
    yield (
        "Generated from `dbc/vcu.yaml` by `python -m scripts.documents`; edit that file, not this "
        "page."
    )
    yield from _source(file)
    yield from _bus(file)
    yield from _identifiers(spec)
    yield from ("", "## Nodes", "", "| node | address | |", "| --- | --- | --- |")
    for name, address in spec.nodes.items():
        yield _row(name, f"0x{address:02X} ({address})", file.nodes[name].comment)
    yield from ("", "## Messages", "")
    yield _how_to_read(spec)
    for reading in file.readings:
        yield from ("", reading)
    yield ""
    yield "| message | identifier | in the source | priority | PGN | from → to | period ms |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    for message in spec.messages:
        yield _message_row(message, *rows[message.name])
    if spec.aliases:
        yield ""
        for alias in file.aliases:
            yield f"0x{alias.id:08X} is received as {alias.message}: {alias.comment}."
    for message in spec.messages:
        yield from _message_section(message, rows[message.name][0], file)
    yield from ("", "## Errata and decisions", "")
    for number, (title, decision) in file.errata.items():
        yield f'- <a id="{number.lower()}"></a>**{number} {title}.** {decision}'
    yield from _own_definition()


def _own_definition() -> Iterator[str]:
    """What a definition of one's own is free in; `requirements` refuses the rest."""
    yield from ("", "## What your own definition may change", "")
    yield (
        "For a vehicle whose devices differ, change `dbc/vcu.yaml` in the source tree "
        "and run `vcu-gateway dbc` and `python -m scripts.documents`: they make the DBC, its "
        "module and this page, and refuse by file and line what the gateway cannot run with. "
        "`demo`, `run`, `check-config` and `doctor` refuse a DBC for the same reasons "
        "(`protocol/dbc.py`). Step by step: [another-vehicle.md](another-vehicle.md)."
    )
    yield from ("", "| | may change | must stay |", "| --- | --- | --- |")
    for cells in _MAY_CHANGE:
        yield _row(*cells)
    yield ""
    yield (
        "`protocol.dbc` in the configuration names a DBC that has more messages or "
        "signals than the packaged one. It may change nothing of what that one has: "
        "the simulator and this page would not know. How a message is added to it: "
        "[pedals.md](pedals.md#the-dbc)."
    )
    yield ""
    yield (
        "The verdict of `replay` and the tests decode by tables of their own, written"
        " by hand, so that a mistake is not made twice: `judge/wire.py`, "
        "`tests/oracle/wire.py` and `tests/protocol/test_dbc.py`. With another "
        "identifier, place or scaling change them as well. Until then tests fail, and "
        "the verdict judges a drive as if nothing had changed."
    )


def _source(file: DefinitionFile) -> Iterator[str]:
    """Where the page comes from, and what counts where that is in doubt."""
    yield ""
    yield (
        f"Source: {file.source}. This page is the specification: the reading of the source "
        "that the gateway implements. Where the source contradicts itself or is silent, "
        "[Errata and decisions](#errata-and-decisions) says what was decided and why. Where the "
        "source is found to say otherwise than this page, the source wins."
    )


def _bus(file: DefinitionFile) -> Iterator[str]:
    yield from ("", "## Bus", "")
    yield (
        "CAN 2.0B, classic CAN in the manner of J1939: 29-bit extended identifiers, 8 data bytes. "
        "The bit rate is not in the source, it is configuration: "
        f"{file.bit_rate_default_bit_s // 1000} kbit/s by default; J1939-11 has 250."
    )


def _identifiers(spec: ProtocolSpec) -> Iterator[str]:
    """The layout of an identifier, and which of them have no receiver in it."""
    yield from ("", "## Identifiers", "")
    yield "| | P | R (EDP) | DP | PF | PS | SA |"
    yield "| --- | --- | --- | --- | --- | --- | --- |"
    yield "| bits | 28-26 | 25 | 24 | 23-16 | 15-8 | 7-0 |"
    yield ""
    to_all = [
        f"0x{can_id:08X}"
        for can_id in (*(message.can_id for message in spec.messages), *spec.aliases)
        if j1939.parse(can_id).destination_address is None
    ]
    yield (
        "P is the priority, SA the sender's address. A PF below 240 (PDU1) makes PS the receiver's "
        f"address; so it is in all identifiers here{_but(to_all)}."
    )


def _but(exceptions: list[str]) -> str:
    return f" but {', '.join(exceptions)}" if exceptions else ""


def _how_to_read(spec: ProtocolSpec) -> str:
    """What the tables of the messages mean."""
    big = [
        message.name
        for message in spec.messages
        if any(signal.byte_order == "big" for signal in message.signals)
    ]
    return (
        "B1 to B8 are BYTE1 to BYTE8 of the source, bit 0 is a byte's least significant bit. "
        f"Two-byte values are little-endian, their first byte is the low one (E5){_but(big)}. "
        "Physical = raw × factor + offset. The names are those used everywhere: DBC, state store, "
        "API, logs."
    )


def _row(*cells: str) -> str:
    """A row of a table; a bar inside a cell would end the cell."""
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _message_row(message: MessageSpec, row: MessageRow, node: str) -> str:
    identifier = j1939.parse(message.can_id)
    return _row(
        f"[{message.name}](#{message.name.lower()})",
        f"0x{message.can_id:08X}",
        row.source_ids.get(node, row.source_id) or "the same",
        str(identifier.priority),
        f"{identifier.pgn} (0x{identifier.pgn:05X})",
        f"{message.sender} → {', '.join(message.receivers)}",
        str(message.period_ms or "—"),
    )


def _message_section(message: MessageSpec, row: MessageRow, file: DefinitionFile) -> Iterator[str]:
    yield from ("", f"## {message.name}", "")
    if texts := [text for text in (message.comment, row.note) if text]:
        yield from (" ".join(f"{text}." for text in texts), "")
    yield "| signal | bits | factor | offset | unit | range | in the source | meaning |"
    yield "| --- | --- | --- | --- | --- | --- | --- | --- |"
    rows = dict(row.signals)
    for group in row.use:
        rows |= file.signal_groups[group]
    for signal in message.signals:
        yield _signal_row(signal, rows[signal.name])
    for bits, why in row.reserved.items():
        yield _row("(reserved)", bits, "", "", "", "", "", why)


def _signal_row(signal: SignalSpec, row: SignalRow) -> str:
    signedness = " signed" if signal.signed else ""
    meaning = [f"{code} {name}: {text}" for code, (name, text) in row.values.items()]
    extra = signal.comment.removeprefix(row.source_term).removeprefix("; ")
    return _row(
        signal.name,
        row.bits + signedness,
        _number(signal.factor),
        _number(signal.offset),
        signal.unit,
        f"{_number(signal.minimum)}…{_number(signal.maximum)}",
        row.source_term,
        "<br>".join([*meaning, *([extra] if extra else [])]),
    )


def _number(number: float) -> str:
    return f"{number:.10g}".replace("-", "−")
