"""config/examples/pedals.dbc and pedals-eec2.dbc: the packaged DBC and a pedal node with it."""

import dataclasses

from vcu_gateway.core.spec import MessageSpec, SignalSpec
from vcu_gateway.protocol import cantools_dbc
from vcu_gateway.protocol.definition import Definition
from vcu_gateway.protocol.definition_model import NodeRow

_VOLT = 0.00125
_POSITION = MessageSpec(
    name="Pedals_Position",
    can_id=0x0810D021,
    sender="PEDALS",
    receivers=("VCU",),
    period_ms=20,
    comment="Both tracks of the throttle pedal, brake pressure, direction",
    signals=(
        SignalSpec("Throttle1", 0, 12, 0, 5, factor=_VOLT, unit="V"),
        SignalSpec("Throttle2", 12, 12, 0, 5, factor=_VOLT, unit="V"),
        SignalSpec("BrakePressure", 24, 10, 0, 100, factor=0.1, unit="bar"),
        SignalSpec("ReverseSwitch", 34, 2, 0, 1, names={0: "forward", 1: "reverse"}),
        SignalSpec("Counter", 48, 4, 0, 15, comment="counts the frames"),
        SignalSpec("Checksum", 56, 8, 0, 255, comment="SAE J1850 over bytes 1 to 7"),
    ),
)
_EEC2 = MessageSpec(
    name="EEC2",
    can_id=0x0CF00300,
    sender="PEDAL",
    receivers=("VCU",),
    period_ms=50,
    comment="J1939-71, Electronic Engine Controller 2, PGN 61443",
    signals=(
        SignalSpec(
            "AccelPedalPos1", 8, 8, 0, 100, factor=0.4, unit="%",
            comment="SPN 91; 0xFE error, 0xFF not available: out of range",
        ),
        SignalSpec("AccelPedalPos2", 32, 8, 0, 100, factor=0.4, unit="%", comment="SPN 29"),
    ),
)  # fmt: skip


def own_node(defined: Definition) -> str:
    """The packaged DBC with a pedal node of the vehicle's own."""
    return _with(defined, _POSITION, NodeRow(address=0x21, comment="Pedal node"))


def eec2(defined: Definition) -> str:
    """The packaged DBC with a pedal that speaks J1939."""
    return _with(defined, _EEC2, NodeRow(address=0x00, comment="Pedal as an engine's"))


def _with(defined: Definition, message: MessageSpec, node: NodeRow) -> str:
    nodes = {**defined.file.nodes, message.sender: node}
    spec = dataclasses.replace(
        defined.spec,
        messages=(*defined.spec.messages, message),
        nodes={name: one.address for name, one in nodes.items()},
    )
    file = defined.file.model_copy(update={"nodes": nodes, "name": "vcu_pedals"})
    return cantools_dbc.write(defined._replace(file=file, spec=spec))
