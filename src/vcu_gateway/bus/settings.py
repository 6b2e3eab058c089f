"""What the bus door is told."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal["socketcan", "virtual", "udp_multicast"]


@dataclass(frozen=True, slots=True)
class BusSettings:
    """What the configuration says of the bus; see config/gateway.yaml.

    Attributes:
        bit_rate_bit_s: what the interface should be set to; None is not held against it.
    """

    interface: Kind
    channel: str
    kernel_filters: bool = True
    gather_s: float = 0.017
    receive_buffer_bytes: int | None = None
    bit_rate_bit_s: int | None = None
