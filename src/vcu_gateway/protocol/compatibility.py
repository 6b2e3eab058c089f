"""Compatibility of a DBC with the packaged one, which the definition gave."""

from collections.abc import Iterator

from vcu_gateway.core.spec import MessageSpec, ProtocolSpec, SignalSpec
from vcu_gateway.protocol.requirements import hexadecimal

_OF_MESSAGE = {"can_id": "identifier", "sender": "sender", "period_ms": "period_ms"}
_OF_SIGNAL = (
    *("start_bit", "length_bits", "byte_order", "signed", "factor", "offset"),
    *("minimum", "maximum", "saturated_raw"),
)


def differences(found: ProtocolSpec, reference: ProtocolSpec) -> Iterator[str]:
    """Differences of `found` from the messages and signals of `reference`, a sentence each.

    What it has besides does not count.
    """
    by_name = {message.name: message for message in found.messages}
    if not any(message.name in by_name for message in reference.messages):
        yield "has none of this vehicle's messages: it is the DBC of something else"
        return
    for expected in reference.messages:
        message = by_name.get(expected.name)
        if message is None:
            yield f"there is no message {expected.name}{hexadecimal(expected)}"
        else:
            yield from _of_message(message, expected)


def _of_message(message: MessageSpec, expected: MessageSpec) -> Iterator[str]:
    where = f"{message.name}{hexadecimal(expected)}"
    for name, label in _OF_MESSAGE.items():
        values = getattr(message, name), getattr(expected, name)
        if name == "can_id":
            values = f"0x{values[0]:08X}", f"0x{values[1]:08X}"
        yield from _of_value(where, label, *values)
    by_name = {signal.name: signal for signal in message.signals}
    for signal in expected.signals:
        if signal.name not in by_name:
            yield f"{where}: there is no signal {signal.name}"
        else:
            where_signal = f"{message.name}.{signal.name}{hexadecimal(expected)}"
            yield from _of_signal(where_signal, by_name[signal.name], signal)


def _of_signal(where: str, signal: SignalSpec, expected: SignalSpec) -> Iterator[str]:
    for name in _OF_SIGNAL:
        yield from _of_value(where, name, getattr(signal, name), getattr(expected, name))


def _of_value(where: str, name: str, value: object, expected: object) -> Iterator[str]:
    if value != expected:
        yield f"{where}: {name} is {value}, not {expected}"
