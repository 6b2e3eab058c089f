"""DBC of the protocol, written and read through cantools.

Source of `protocol/vcu_dbc.py`: what cantools reads in a DBC, as data of the program.
"""

import dataclasses
import hashlib
import json
from collections import OrderedDict
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from vcu_gateway import python_can  # noqa: F401 - cantools imports python-can

# isort: split
import cantools
from cantools.database import Database, Message, Node, Signal
from cantools.database.can.formats.dbc.dbc_attribute import DbcAttribute
from cantools.database.can.formats.dbc.dbc_attribute_definition import DbcAttributeDefinition
from cantools.database.can.formats.dbc.dbc_specifics import DbcSpecifics
from cantools.database.conversion import BaseConversion
from cantools.database.namedsignalvalue import NamedSignalValue

from vcu_gateway.core import j1939
from vcu_gateway.core.spec import FRAME_LENGTH_BYTES, MessageSpec, ProtocolSpec, SignalSpec, plain
from vcu_gateway.errors import DataError, Problem

if TYPE_CHECKING:
    from vcu_gateway.protocol.definition import Definition


_FRAME_FORMATS = ["StandardCAN", "ExtendedCAN", "reserved", "J1939PG"]
_SATURATED = "VcuSaturatedRaw"
_NOT_SATURATED = -1
_READ_HERE = (
    f"only 29-bit identifiers, {FRAME_LENGTH_BYTES} bytes and whole numbers are read: take the "
    "message out of this DBC"
)

_ATTRIBUTES: list[Any] = [
    DbcAttributeDefinition("BusType", default_value="CAN", type_name="STRING"),
    DbcAttributeDefinition("ProtocolType", default_value="J1939", type_name="STRING"),
    DbcAttributeDefinition("DBName", default_value="", type_name="STRING"),
    DbcAttributeDefinition("NmStationAddress", 254, "BU_", "INT", 0, 255),
    DbcAttributeDefinition("VFrameFormat", "StandardCAN", "BO_", "ENUM", choices=_FRAME_FORMATS),
    DbcAttributeDefinition("GenMsgCycleTime", 0, "BO_", "INT", 0, 65535),
    DbcAttributeDefinition(_SATURATED, _NOT_SATURATED, "SG_", "INT", _NOT_SATURATED, 2**31 - 1),
]
_DEFINITIONS: OrderedDict[str, Any] = OrderedDict((one.name, one) for one in _ATTRIBUTES)


def write(definition: "Definition") -> str:
    """The DBC of a definition, the same text every time."""
    file, spec = definition.file, definition.spec
    database = Database(
        messages=[_message(message) for message in spec.messages],
        nodes=[
            Node(name, file.nodes[name].comment or None, _specifics(NmStationAddress=address))
            for name, address in spec.nodes.items()
        ],
        version=file.version,
        dbc_specifics=DbcSpecifics(
            attributes=_attributes(BusType="CAN", ProtocolType="J1939", DBName=file.name),
            attribute_definitions=_DEFINITIONS.copy(),
        ),
    )
    return str(database.as_dbc_string(sort_signals=None)).replace("\r\n", "\n")


def _attributes(**values: Any) -> OrderedDict[str, Any]:
    return OrderedDict((name, DbcAttribute(v, _DEFINITIONS[name])) for name, v in values.items())


def _specifics(**values: Any) -> DbcSpecifics:
    return DbcSpecifics(attributes=_attributes(**values))


def _message(message: MessageSpec) -> Message:
    return Message(
        frame_id=message.can_id,
        name=message.name,
        length=FRAME_LENGTH_BYTES,
        signals=[_signal(signal, message) for signal in message.signals],
        comment=message.comment or None,
        senders=[message.sender],
        is_extended_frame=True,
        strict=True,
        protocol="j1939",
        cycle_time=message.period_ms,
        sort_signals=None,
    )


def _signal(signal: SignalSpec, message: MessageSpec) -> Signal:
    choices: Any = OrderedDict(
        (code, NamedSignalValue(code, name)) for code, name in signal.names.items()
    )
    saturated = signal.saturated_raw
    attributes = {} if saturated is None else {_SATURATED: saturated}
    return Signal(
        name=signal.name,
        start=signal.start_bit,
        length=signal.length_bits,
        byte_order="little_endian" if signal.byte_order == "little" else "big_endian",
        is_signed=signal.signed,
        conversion=BaseConversion.factory(
            scale=plain(signal.factor), offset=plain(signal.offset), choices=choices or None
        ),
        minimum=plain(signal.minimum),
        maximum=plain(signal.maximum),
        unit=signal.unit or None,
        comment=signal.comment or None,
        receivers=list(message.receivers),
        dbc_specifics=_specifics(**attributes),
    )


def parse(text: str, where: str = "dbc") -> ProtocolSpec:
    """Read a DBC for the decoders and encoders; `where` is the file name that errors show.

    Raises DataError where it is no DBC or holds what this gateway cannot decode.
    """
    try:
        database: Any = cantools.database.load_string(text, "dbc", sort_signals=None)
    except (cantools.Error, ValueError) as error:
        what = f"is no DBC that cantools reads: {' '.join(str(error).split())}"
        raise DataError(Problem(what, where)) from error
    problems = [
        Problem(what, where, _READ_HERE)
        for message in database.messages
        for what in _unfit(message)
    ]
    if problems:
        raise DataError(*problems)
    return ProtocolSpec(
        messages=tuple(_read_message(message) for message in database.messages),
        nodes={node.name: _node_address(node) for node in database.nodes},
    )


def _unfit(message: Any) -> list[str]:
    found = []
    is_extended = message.is_extended_frame
    identifier = f"(0x{message.frame_id:0{8 if is_extended else 3}X})"
    name = f"{message.name} {identifier}"
    if not is_extended:
        found.append(f"{name}: has an 11-bit identifier")
    if message.length != FRAME_LENGTH_BYTES:
        found.append(f"{name}: has {message.length} bytes, not {FRAME_LENGTH_BYTES}")
    if not message.senders:
        found.append(f"{name}: has no sender")
    found += [
        f"{message.name}.{signal.name} {identifier}: is a float or multiplexed signal"
        for signal in message.signals
        if signal.is_float or signal.multiplexer_ids or signal.is_multiplexer
    ]
    return found


def _node_address(node: Any) -> int:
    attributes = node.dbc.attributes if node.dbc else {}
    attribute = attributes.get("NmStationAddress")
    return int(attribute.value) if attribute is not None else 254


def _read_message(message: Any) -> MessageSpec:
    receivers = dict.fromkeys(r for signal in message.signals for r in signal.receivers)
    return MessageSpec(
        name=message.name,
        can_id=message.frame_id & j1939.ID_MASK,
        sender=message.senders[0],
        receivers=tuple(receivers),
        period_ms=message.cycle_time or None,
        signals=tuple(_read_signal(signal) for signal in message.signals),
        comment=message.comment or "",
    )


def _read_signal(signal: Any) -> SignalSpec:
    attributes = signal.dbc.attributes if signal.dbc else {}
    saturated = attributes.get(_SATURATED)
    order: Any = "little" if signal.byte_order == "little_endian" else "big"
    bits = SignalSpec(signal.name, signal.start, signal.length, 0, 0, order, signal.is_signed)
    ends = [raw * signal.scale + signal.offset for raw in (bits.raw_lowest, bits.raw_highest)]
    return dataclasses.replace(
        bits,
        factor=float(signal.scale),
        offset=float(signal.offset),
        unit=signal.unit or "",
        minimum=min(ends) if signal.minimum is None else float(signal.minimum),
        maximum=max(ends) if signal.maximum is None else float(signal.maximum),
        names={code: str(named) for code, named in (signal.choices or {}).items()},
        saturated_raw=None if saturated is None else int(saturated.value),
        comment=signal.comment or "",
    )


_HEAD = '''"""Protocol that cantools reads in dbc/vcu.dbc.

Made by `vcu-gateway dbc`; do not change it here.

`protocol.dbc` takes it where the SHA-256 of the DBC in use is this one.
"""

from vcu_gateway.core.spec import MessageSpec, ProtocolSpec, SignalSpec

# fmt: off
'''


def module_text(dbc_text: str) -> str:
    """The module of a DBC, the same text every time."""
    protocol = parse(dbc_text)
    digest = hashlib.sha256(dbc_text.encode()).hexdigest()
    lines = [
        f"SHA256 = {_literal(digest)}",
        "PROTOCOL = ProtocolSpec(",
        f"    nodes={_literal(protocol.nodes)},",
        "    messages=(",
        *(line for message in protocol.messages for line in _message_lines(message)),
        "    ),",
        ")",
    ]
    return _HEAD + "\n".join(lines) + "\n"


def _message_lines(message: MessageSpec) -> Iterator[str]:
    yield "        MessageSpec("
    yield "            " + ", ".join(_arguments(message, leave_out="signals")) + ","
    yield "            signals=("
    for signal in message.signals:
        yield f"                SignalSpec({', '.join(_arguments(signal))}),"
    yield "            ),"
    yield "        ),"


def _arguments(spec: MessageSpec | SignalSpec, leave_out: str = "") -> Iterator[str]:
    """Each field by its name, those at their default left out."""
    for field in dataclasses.fields(spec):
        value = getattr(spec, field.name)
        default = field.default
        if field.default_factory is not dataclasses.MISSING:
            default = field.default_factory()
        if field.name != leave_out and value != default:
            hexadecimal = field.name == "can_id"
            yield f"{field.name}={f'0x{value:08X}' if hexadecimal else _literal(value)}"


def _literal(value: object) -> str:
    """Python source of a value, text in double quotes as everywhere in the source."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_literal(k)}: {_literal(v)}" for k, v in value.items()) + "}"
    if isinstance(value, tuple):
        return "(" + "".join(f"{_literal(item)}, " for item in value).rstrip() + ")"
    return repr(value)
