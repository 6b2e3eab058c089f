"""Compatibility of a DBC with the protocol that the safety rules were written for."""

from collections.abc import Iterator

from vcu_gateway.core.spec import MessageSpec, ProtocolSpec, SignalSpec

_OF_MESSAGE = ("can_id", "sender", "period_ms")
_OF_SIGNAL = (
    *("start_bit", "length_bits", "byte_order", "signed", "factor", "offset"),
    *("minimum", "maximum", "saturated_raw"),
)


def differences(found: ProtocolSpec, reference: ProtocolSpec) -> Iterator[str]:
    """Differences of `found` from the messages and signals of `reference`, a sentence each.

    What it has besides does not count.
    """
    by_name = {message.name: message for message in found.messages}
    for expected in reference.messages:
        message = by_name.get(expected.name)
        if message is None:
            yield f"there is no message {expected.name}"
        else:
            yield from _of_message(message, expected)


def _of_message(message: MessageSpec, expected: MessageSpec) -> Iterator[str]:
    for name in _OF_MESSAGE:
        yield from _of_value(message.name, name, getattr(message, name), getattr(expected, name))
    by_name = {signal.name: signal for signal in message.signals}
    for signal in expected.signals:
        if signal.name not in by_name:
            yield f"{message.name} has no signal {signal.name}"
        else:
            yield from _of_signal(message.name, by_name[signal.name], signal)


def _of_signal(message: str, signal: SignalSpec, expected: SignalSpec) -> Iterator[str]:
    where = f"{message}.{signal.name}"
    for name in _OF_SIGNAL:
        yield from _of_value(where, name, getattr(signal, name), getattr(expected, name))


def _of_value(where: str, name: str, value: object, expected: object) -> Iterator[str]:
    if value != expected:
        yield f"{where}: {name} is {value}, not {expected}"
