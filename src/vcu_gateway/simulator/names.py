"""Names in a scenario: nodes, messages, signals and controllers that the protocol has."""

from typing import Annotated

from pydantic import AfterValidator, ValidationInfo

from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.receive import OWN_NODE
from vcu_gateway.core.spec import ProtocolSpec, SignalSpec
from vcu_gateway.errors import did_you_mean
from vcu_gateway.strict_yaml.validation import refusal

PROTOCOL = "protocol"
"""Key of the validation's context; it holds the ProtocolSpec that names must be in."""


def protocol_of(info: ValidationInfo) -> ProtocolSpec:
    protocol: ProtocolSpec = (info.context or {})[PROTOCOL]
    return protocol


def _one_of(name: str, known: list[str], what: str) -> str:
    if name not in known:
        near = did_you_mean(name, known)
        raise refusal(f"must be {what}", near or f"these are {', '.join(known)}")
    return name


def _senders(info: ValidationInfo) -> list[str]:
    return [node for node in protocol_of(info).nodes if node != OWN_NODE]


def _sent_messages(info: ValidationInfo) -> list[str]:
    """Names of the messages that every node but the gateway sends, node by node."""
    protocol = protocol_of(info)
    return [message.name for node in _senders(info) for message in protocol.sent_by(node)]


def _node_or_message(name: str, info: ValidationInfo) -> str:
    known = [*_senders(info), *_sent_messages(info)]
    return _one_of(name, known, "a node or a message that it sends")


def _signal(name: str, info: ValidationInfo) -> str:
    protocol = protocol_of(info)
    messages = _sent_messages(info)
    message, _, signal = name.partition(".")
    if message not in messages:
        nearest = did_you_mean(message, messages)
        remedy = nearest or f"the messages are {', '.join(messages)}"
        raise refusal("must be MESSAGE.SIGNAL, such as BMS_Status.SOC", remedy)
    _one_of(signal, list(protocol.message(message).signal_names), f"a signal of {message}")
    return name


def _controller(name: str) -> str:
    return _one_of(name, list(CONTROLLERS), "a motor controller")


Target = Annotated[str, AfterValidator(_node_or_message)]
SignalName = Annotated[str, AfterValidator(_signal)]
Controller = Annotated[str, AfterValidator(_controller)]


def signal_spec(signal: str, protocol: ProtocolSpec) -> SignalSpec:
    message, _, name = signal.partition(".")
    return protocol.message(message).signal(name)
