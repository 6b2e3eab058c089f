"""Command fields: what two commands of one controller say differently, in words and units."""

from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.core.codec import Codec, MessageCodec
from vcu_gateway.core.commands import message_name
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.spec import FRAME_LENGTH_BYTES, SignalSpec
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.recording.writers import decimals

FRAME_FIELD = "frame"
"""The field of a command that only one side sends."""


class FieldChange(NamedTuple):
    """One field of a command that is another one.

    Attributes:
        before, after: as a person reads them, with their unit.
        amount: how far they are apart in the field's unit; 1 where that says nothing.
    """

    controller: str
    field: str
    before: str
    after: str
    amount: float


class CommandFields:
    """Both controllers' commands taken apart."""

    def __init__(self, codec: Codec) -> None:
        self._codecs = {name: codec.by_name[message_name(name)] for name in CONTROLLERS}

    def changes(
        self, before: tuple[OutFrame, ...], after: tuple[OutFrame, ...]
    ) -> Iterator[FieldChange]:
        """Every field in which the frames of a tick differ."""
        if before == after:
            return
        first, second = _by_controller(before), _by_controller(after)
        for name, codec in self._codecs.items():
            one, other = first.get(name), second.get(name)
            if one is None or other is None:
                if one is not other:
                    yield FieldChange(name, FRAME_FIELD, _sent(one), _sent(other), 1.0)
                continue
            yield from _different(name, codec, one, other)


def _by_controller(frames: tuple[OutFrame, ...]) -> dict[str, OutFrame]:
    return {frame.controller: frame for frame in frames}


def _sent(frame: OutFrame | None) -> str:
    return "none" if frame is None else f"{frame.can_id:08X}#{frame.data.hex()}"


def _different(
    name: str, codec: MessageCodec, one: OutFrame, other: OutFrame
) -> Iterator[FieldChange]:
    if one.can_id != other.can_id:
        yield FieldChange(name, "identifier", f"{one.can_id:08X}", f"{other.can_id:08X}", 1.0)
    if one.data == other.data:
        return
    if len(one.data) != len(other.data) or len(one.data) != FRAME_LENGTH_BYTES:
        yield FieldChange(name, FRAME_FIELD, _sent(one), _sent(other), 1.0)
        return
    found = False
    values = zip(codec.decode(one.data).values, codec.decode(other.data).values, strict=True)
    for signal, (was, is_) in zip(codec.spec.signals, values, strict=True):
        if was != is_:
            found = True
            amount = 1.0 if signal.names else abs(is_ - was)
            yield FieldChange(name, signal.name, told(signal, was), told(signal, is_), amount)
    if not found:
        yield FieldChange(name, "reserved bits", one.data.hex(), other.data.hex(), 1.0)


def told(signal: SignalSpec, value: float) -> str:
    """A value with its unit, or the name of its code."""
    if name := signal.names.get(round(value)):
        return name
    unit = f" {signal.unit}" if signal.unit else ""
    return f"{round(value, decimals(signal)) + 0:g}{unit}"
