"""Codec: frames to messages and back, whole or not at all.

One decoder and one encoder is written out as Python source for each message and compiled
once, at start: loops and look-ups are gone before the first frame arrives.
"""

import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import partial
from typing import Any, NamedTuple

from vcu_gateway.core import codegen, j1939
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.spec import FRAME_LENGTH_BYTES, MessageSpec, ProtocolSpec

_ALL_BITS = struct.Struct("<Q")
_HUGE = 10**300


class _Fields(NamedTuple):
    values: tuple[float, ...]
    raws: tuple[int, ...]
    marks: int


class Decoded(tuple[tuple[float, ...], tuple[int, ...], int]):
    """The signals of one frame, in the order of `MessageSpec.signals`.

    The three parts are given as one tuple: without a constructor in Python, decoding costs
    a tenth less.

    Attributes:
        values: physical values in the signals' units; int where factor and offset are whole.
        raws: the codes on the wire.
        marks: bit i is set where signal i is outside its range or saturated (E4, E12).
    """

    __slots__ = ()
    values = _Fields.values
    raws = _Fields.raws
    marks = _Fields.marks


class Reason(Enum):
    """Reason for not decoding a frame."""

    ERROR = "error"
    REMOTE = "remote"
    STANDARD = "standard_id"
    UNKNOWN = "unknown"
    FOREIGN_SOURCE = "foreign_source"
    SHORT = "short"
    LONG = "long"


Decoder = Callable[[bytes | bytearray], Decoded]
Encoder = Callable[[Mapping[str, float]], bytes]


@dataclass(frozen=True, slots=True)
class MessageCodec:
    """A message with its compiled decoder and encoder.

    decode: eight bytes -> Decoded; never raises for eight bytes.
    encode: {signal name: physical value} -> eight bytes. Rounds to the nearest code and
        saturates at the signal's range; never wraps or raises. A signal left out is sent as
        the code nearest to 0, NaN as the lowest code of the range.
    """

    spec: MessageSpec
    decode: Decoder
    encode: Encoder


class Codec:
    """Every message of a protocol, found by PF, PS and SA whatever the priority."""

    def __init__(self, protocol: ProtocolSpec) -> None:
        self.protocol = protocol
        self.by_name = {message.name: compile_message(message) for message in protocol.messages}
        known = {m.spec.can_id: m for m in self.by_name.values()}
        known |= {can_id: self.by_name[name] for can_id, name in protocol.aliases.items()}
        self._by_id = {
            j1939.with_priority(can_id, priority): message
            for can_id, message in known.items()
            for priority in range(8)
        }
        self._groups = {j1939.group_key(can_id) for can_id in known}

    def identifiers(self) -> tuple[int, ...]:
        """Every identifier that is decoded, aliases included, priority 0."""
        return tuple(sorted({j1939.match_key(can_id) for can_id in self._by_id}))

    def find(self, frame: Frame) -> MessageCodec | Reason:
        """Codec of this frame, or the reason why there is none.

        Only extended data frames of exactly eight bytes are decoded.
        """
        if frame.error:
            return Reason.ERROR
        if frame.remote:
            return Reason.REMOTE
        if not frame.extended:
            return Reason.STANDARD
        found = self._by_id.get(frame.can_id)
        if found is None:
            known_group = j1939.group_key(frame.can_id) in self._groups
            return Reason.FOREIGN_SOURCE if known_group else Reason.UNKNOWN
        if len(frame.data) != FRAME_LENGTH_BYTES:
            return Reason.SHORT if len(frame.data) < FRAME_LENGTH_BYTES else Reason.LONG
        return found


def compile_message(message: MessageSpec) -> MessageCodec:
    layout = codegen.plan(message)
    names = {
        "Decoded": Decoded,
        "unpack": struct.Struct(layout.struct_format).unpack,
        "unpack_all": _ALL_BITS.unpack,
        "pack": struct.Struct(layout.struct_format).pack,
        "pack_all": _ALL_BITS.pack,
        "complete": partial(_complete, message.signal_names),
    }
    decode = _build("decode", codegen.decoder(message, layout), names)
    encode = _build("encode", codegen.encoder(message, layout), names)
    return MessageCodec(message, decode, encode)


def _build(name: str, text: str, names: Mapping[str, object]) -> Any:
    namespace = dict(names)
    exec(compile(text, f"<{name}>", "exec"), namespace)  # noqa: S102 - our own numbers and names only
    return namespace[name]


def _complete(names: tuple[str, ...], values: Mapping[str, float]) -> dict[str, float]:
    """Value of every signal: 0 where it was left out, an int only where a float can follow."""
    found = {name: values.get(name, 0.0) for name in names}
    return {
        name: max(-_HUGE, min(_HUGE, value)) if isinstance(value, int) else value
        for name, value in found.items()
    }
