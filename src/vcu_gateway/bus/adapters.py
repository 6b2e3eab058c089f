"""One interface for every bus of python-can: SocketCAN as it is read here, and any other."""

from collections.abc import Callable
from typing import Any, Protocol

from vcu_gateway.bus.settings import BusCounters, BusSettings
from vcu_gateway.bus.socketcan import DrainingSocketcanBus
from vcu_gateway.python_can import can


class Bus(Protocol):
    """One open bus; OSError or can.CanError where its interface fails."""

    @property
    def library_bus(self) -> can.BusABC:
        """python-can's bus, for its Notifier."""

    @property
    def stamps_are_monotonic(self) -> bool:
        """True where `Message.timestamp` is of the monotonic clock, not of the wall clock."""

    @property
    def receive_buffer_bytes(self) -> int | None:
        """Receive buffer that the kernel granted; None where the bus has none."""

    @property
    def wakes(self) -> int | None:
        """Times that the reader woke; None where the bus does not count them."""

    def align(self, origin_ns: int, period_ns: int) -> None:
        """Read shortly before every point of this grid."""

    def read_waiting(self, until_ns: int, hand_on: Callable[[can.Message], None]) -> bool:
        """Hand on, on the calling thread, what arrived until this time; False where it cannot."""

    def send_now(self, can_id: int, data: bytes) -> None:
        """Send one extended data frame without waiting."""

    def finish(self) -> None:
        """Count what was never read; only when the reader has ended."""


class PlainBus:
    """A bus whose reader has every frame as soon as it is there; nothing waits in a socket."""

    stamps_are_monotonic = False
    receive_buffer_bytes = None
    wakes = None

    def __init__(self, library_bus: can.BusABC) -> None:
        self.library_bus = library_bus

    def align(self, origin_ns: int, period_ns: int) -> None:
        """Nothing to align."""

    def read_waiting(self, until_ns: int, hand_on: Callable[[can.Message], None]) -> bool:
        """True: nothing waits."""
        del until_ns, hand_on
        return True

    def send_now(self, can_id: int, data: bytes) -> None:
        """Send one extended data frame."""
        self.library_bus.send(can.Message(arbitration_id=can_id, data=data))

    def finish(self) -> None:
        """Nothing to count."""


def open_bus(settings: BusSettings, filters: list[Any] | None, counters: BusCounters) -> Bus:
    """Open a bus; OSError, can.CanError or ImportError where that cannot be."""
    if settings.interface == "socketcan":
        return DrainingSocketcanBus(
            settings.channel,
            filters,
            settings.gather_s,
            settings.receive_buffer_bytes,
            counters,
        )
    if settings.interface == "udp_multicast":
        from vcu_gateway.bus.multicast import EchoingMulticastBus

        return PlainBus(EchoingMulticastBus(settings.channel, filters, counters))
    return PlainBus(
        can.Bus(
            interface=settings.interface,
            channel=settings.channel,
            can_filters=filters,
            receive_own_messages=True,
        )
    )
