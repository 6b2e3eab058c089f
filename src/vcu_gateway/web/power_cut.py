"""POWER_CUT in the bytes of the command frames that were sent, read from the bytes alone."""

from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.api.results import Protocol, State

_BITS_PER_BYTE = 8


class PowerCutBit(NamedTuple):
    """Place of the bit POWER_CUT in one controller's command frame."""

    can_id: int
    bit: int

    def is_set_in(self, frame: str | None) -> bool:
        """Whether this frame, as candump writes it, is that command with the bit set."""
        identifier, _, data = (frame or "").partition("#")
        try:
            can_id, octets = int(identifier, 16), bytes.fromhex(data)
        except ValueError:
            return False
        byte, bit = divmod(self.bit, _BITS_PER_BYTE)
        return can_id == self.can_id and byte < len(octets) and bool(octets[byte] >> bit & 1)


PowerCutBits = Mapping[str, PowerCutBit]


def power_cut_bits(protocol: Protocol) -> PowerCutBits:
    """The bit by controller, from the protocol's definition."""
    return {
        message["receivers"][0]: PowerCutBit(int(message["can_id"], 16), signal["start_bit"])
        for message in protocol["messages"]
        for signal in message["signals"]
        if message["sender"] == "VCU" and signal["name"] == "PowerCut"
    }


def is_cut(state: State, bits: PowerCutBits) -> bool:
    """Whether the last tick was in fault and sent POWER_CUT to every controller."""
    commands = state["commands"]
    frames: dict[str, str | None] = {name: command["frame"] for name, command in commands.items()}
    every = bool(bits) and all(bit.is_set_in(frames.get(name)) for name, bit in bits.items())
    return state["mode"] == "fault" and every
