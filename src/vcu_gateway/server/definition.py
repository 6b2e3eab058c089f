"""The protocol in the API's shape."""

from vcu_gateway.api import results
from vcu_gateway.core.spec import MessageSpec, ProtocolSpec, SignalSpec


def definition(protocol: ProtocolSpec, digest: str) -> results.Protocol:
    """Every message and signal."""
    return {
        "digest": digest,
        "messages": [_message(message) for message in protocol.messages],
        "aliases": {f"0x{can_id:08X}": name for can_id, name in protocol.aliases.items()},
    }


def _message(message: MessageSpec) -> results.MessageDefinition:
    return {
        "name": message.name,
        "can_id": f"0x{message.can_id:08X}",
        "sender": message.sender,
        "receivers": list(message.receivers),
        "period_ms": message.period_ms,
        "signals": [_signal(signal) for signal in message.signals],
        "comment": message.comment,
    }


def _signal(signal: SignalSpec) -> results.SignalDefinition:
    return {
        "name": signal.name,
        "unit": signal.unit,
        "minimum": signal.minimum,
        "maximum": signal.maximum,
        "factor": signal.factor,
        "offset": signal.offset,
        "start_bit": signal.start_bit,
        "length_bits": signal.length_bits,
        "byte_order": signal.byte_order,
        "signed": signal.signed,
        "names": {str(code): name for code, name in signal.names.items()},
        "comment": signal.comment,
    }
