"""Values of a CAN interface as the kernel reports them."""

from enum import IntFlag
from typing import NamedTuple

from vcu_gateway.core.link import LinkState


class InterfaceDetails(NamedTuple):
    """Details of one CAN interface; None is not known.

    Attributes:
        driver_echoes: our frames come back from the driver once they have left; where it does
            not, the kernel sends them back at once, which proves nothing.
        queue_is_used: False where frames go to the driver without any queue (vcan).
        state: of the controller; None too where there is no controller.
        bit_rate_bit_s: that the controller is set to.
        carrier: as it is at this instant.
    """

    driver_echoes: bool | None = None
    queue_is_used: bool | None = None
    state: LinkState | None = None
    bit_rate_bit_s: int | None = None
    carrier: bool | None = None


class ControllerMode(IntFlag):
    """Modes of a controller (CAN_CTRLMODE)."""

    LOOPBACK = 0x01
    LISTEN_ONLY = 0x02
    ONE_SHOT = 0x08
    ERROR_REPORTING = 0x10
    FD = 0x20
    PRESUME_ACK = 0x40


class ErrorCounters(NamedTuple):
    """The CAN protocol's error counters, 0..255."""

    transmit: int
    receive: int


class DeviceCounters(NamedTuple):
    """Counters of a controller since its driver was loaded."""

    bus_errors: int
    warnings: int
    passives: int
    bus_offs: int
    arbitrations_lost: int
    restarts: int


class CanController(NamedTuple):
    """A CAN controller; None is what its driver does not report.

    Attributes:
        restart_ms: time from bus-off to its restart by itself; 0 is never.
    """

    restart_ms: int | None = None
    modes: ControllerMode | None = None
    errors: ErrorCounters | None = None
    counters: DeviceCounters | None = None


class InterfaceTraffic(NamedTuple):
    """Frame counters since the interface exists."""

    received: int
    sent: int
    receive_dropped: int
    send_dropped: int
    overruns: int


class InterfaceInfo(NamedTuple):
    """Everything known of an interface; None and empty are not known.

    Attributes:
        kind: the kernel's word, such as vcan; can is any with a controller.
        discipline: the queueing discipline; noqueue is none.
        controller: None where there is none.
    """

    details: InterfaceDetails
    up: bool
    is_can: bool
    kind: str = ""
    discipline: str = ""
    tx_queue_frames: int | None = None
    controller: CanController | None = None
    traffic: InterfaceTraffic | None = None
