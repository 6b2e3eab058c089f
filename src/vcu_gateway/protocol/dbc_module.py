"""Source of `protocol/vcu_dbc.py`: what cantools reads in a DBC, as data of the program."""

import dataclasses
import hashlib
import json
from collections.abc import Iterator

from vcu_gateway.core.spec import MessageSpec, SignalSpec
from vcu_gateway.protocol import cantools_dbc

_HEAD = '''"""Protocol that cantools reads in dbc/vcu.dbc.

Made by `vcu-gateway dbc`; do not change it here.

`protocol.dbc` takes it where the SHA-256 of the DBC in use is this one.
"""

from vcu_gateway.core.spec import MessageSpec, ProtocolSpec, SignalSpec

# fmt: off
'''


def module_text(dbc_text: str) -> str:
    """The module of a DBC, the same text every time."""
    protocol = cantools_dbc.parse(dbc_text)
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
