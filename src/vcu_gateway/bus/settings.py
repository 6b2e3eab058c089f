"""Settings, counters and clocks of the bus connection."""

import time
from dataclasses import dataclass, field
from typing import Literal

from vcu_gateway.core.schedule import ClockPair

Kind = Literal["socketcan", "virtual", "udp_multicast"]


@dataclass(frozen=True, slots=True)
class BusSettings:
    """Settings of the bus; see config/gateway.yaml.

    Attributes:
        receive_buffer_bytes: as SO_RCVBUF takes it; None: enough for some periods of a full bus.
        bit_rate_bit_s: bit rate that the interface should have; None: any.
    """

    interface: Kind
    channel: str
    kernel_filters: bool = True
    receive_buffer_bytes: int | None = None
    bit_rate_bit_s: int | None = None


@dataclass(slots=True)
class BusCounters:
    """Counters of the bus, each written by one thread at a time.

    Attributes:
        refused: frames that could not be sent at once, by errno name.
        dropped: frames that the kernel's receive buffer had no room for, or that waited in it
            when the socket was closed.
        repeated_errors: error frames equal to the one before; not evaluated.
        undecodable: datagrams of a multicast group that hold no frame.
        receiver_bugs: exceptions of our own receiving code; the frame is lost, the rest goes on.
    """

    received: int = 0
    sent: int = 0
    refused: dict[str, int] = field(default_factory=dict)
    dropped: int = 0
    repeated_errors: int = 0
    undecodable: int = 0
    receiver_bugs: int = 0
    last_bug: str = ""


_CLOSE_ENOUGH_NS = 50_000
_TRIES = 3


def read_clocks() -> ClockPair:
    """Read the wall clock between two readings of the monotonic one.

    A reading torn apart by the scheduler is taken again; the closest of three counts.
    """
    readings = []
    for _ in range(_TRIES):
        first_ns, wall_ns, last_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if last_ns - first_ns <= _CLOSE_ENOUGH_NS:
            return ClockPair(first_ns, wall_ns)
        readings.append((last_ns - first_ns, ClockPair(first_ns, wall_ns)))
    return min(readings, key=lambda reading: reading[0])[1]
