"""Protocol as values: messages, signals and their layout."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

ByteOrder = Literal["little", "big"]
FRAME_LENGTH_BYTES = 8

# Limits are decimals: 65.535 / 0.001 may come out a hair below the code that is meant.
_RANGE_TOLERANCE_RAW = 1e-6


def plain(number: float) -> float:
    """An int where it is whole, which is written without a decimal point."""
    return int(number) if float(number).is_integer() else number


@dataclass(frozen=True, slots=True)
class SignalSpec:
    """One signal: position, scaling and codes of its bits.

    Attributes:
        name: the signal's one name, as in the DBC, the store, the API and the logs.
        start_bit: as in a DBC: least significant bit for little, most significant for big
            byte order; bit 0 is the least significant bit of byte 1.
        length_bits: 1 to 64.
        factor, offset: physical = raw * factor + offset; factor is never 0.
        unit: empty for enumerations and counts.
        minimum, maximum: physical range, in `unit`.
        names: name of each raw code of an enumeration, empty for a quantity.
        saturated_raw: the raw code that means "at or above the largest value", or None.
    """

    name: str
    start_bit: int
    length_bits: int
    minimum: float
    maximum: float
    byte_order: ByteOrder = "little"
    signed: bool = False
    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    names: Mapping[int, str] = field(default_factory=dict, hash=False)
    saturated_raw: int | None = None
    comment: str = ""

    @property
    def raw_lowest(self) -> int:
        """The lowest code that the bits hold."""
        return -(1 << (self.length_bits - 1)) if self.signed else 0

    @property
    def raw_highest(self) -> int:
        """The highest code that the bits hold."""
        return (1 << (self.length_bits - self.signed)) - 1

    @property
    def raw_minimum(self) -> int:
        """The lowest code inside the range."""
        return max(self.raw_lowest, math.ceil(min(self._raw_limits()) - _RANGE_TOLERANCE_RAW))

    @property
    def raw_maximum(self) -> int:
        """The highest code inside the range."""
        return min(self.raw_highest, math.floor(max(self._raw_limits()) + _RANGE_TOLERANCE_RAW))

    def _raw_limits(self) -> tuple[float, float]:
        return (
            (self.minimum - self.offset) / self.factor,
            (self.maximum - self.offset) / self.factor,
        )

    def bit_positions(self) -> tuple[int, ...]:
        """Positions of the bits in the frame, byte * 8 + bit, least significant first."""
        if self.byte_order == "little":
            return tuple(range(self.start_bit, self.start_bit + self.length_bits))
        # Big byte order walks down inside a byte and then to the top of the next byte.
        sequential = (self.start_bit // 8) * 8 + 7 - self.start_bit % 8
        walked = range(sequential, sequential + self.length_bits)
        return tuple((bit // 8) * 8 + 7 - bit % 8 for bit in reversed(walked))


@dataclass(frozen=True, slots=True)
class MessageSpec:
    """One message of eight bytes.

    Attributes:
        can_id: 29-bit identifier with the printed priority.
        sender: name of the sending node; receivers: names of the others.
        period_ms: nominal period; None where it is not cyclic.
    """

    name: str
    can_id: int
    sender: str
    receivers: tuple[str, ...]
    period_ms: int | None
    signals: tuple[SignalSpec, ...]
    comment: str = ""

    @property
    def signal_names(self) -> tuple[str, ...]:
        """The signals' names in the order of the decoder's tuples."""
        return tuple(signal.name for signal in self.signals)

    def signal(self, name: str) -> SignalSpec:
        """The signal of that name; KeyError where there is none."""
        for signal in self.signals:
            if signal.name == name:
                return signal
        raise KeyError(f"{self.name} has no signal {name}")


@dataclass(frozen=True, slots=True)
class ProtocolSpec:
    """Every message of the bus, and the identifiers that stand for one of them.

    Attributes:
        nodes: source address of each node.
        aliases: further identifier -> message name (docs/protocol.md E3).
    """

    messages: tuple[MessageSpec, ...]
    nodes: Mapping[str, int] = field(hash=False)
    aliases: Mapping[int, str] = field(hash=False, default_factory=dict)

    def message(self, name: str) -> MessageSpec:
        """The message of that name; KeyError where there is none."""
        for message in self.messages:
            if message.name == name:
                return message
        raise KeyError(f"the protocol has no message {name}")

    def sent_by(self, node: str) -> tuple[MessageSpec, ...]:
        return tuple(message for message in self.messages if message.sender == node)

    def received_by(self, node: str) -> tuple[MessageSpec, ...]:
        return tuple(message for message in self.messages if node in message.receivers)
