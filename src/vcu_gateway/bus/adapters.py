"""One interface for every bus of python-can: SocketCAN as it is read here, and any other."""

from typing import Any, Protocol

from vcu_gateway.bus.reader import DrainingReader, Reader, ThreadReader
from vcu_gateway.bus.receiver import FrameListener
from vcu_gateway.bus.settings import BusCounters, BusSettings
from vcu_gateway.bus.socketcan import DrainingSocketcanBus
from vcu_gateway.python_can import can


class Bus(Protocol):
    """One open bus; OSError or can.CanError where its interface fails."""

    @property
    def stamps_are_monotonic(self) -> bool:
        """True where `Message.timestamp` is of the monotonic clock, not of the wall clock."""

    @property
    def receive_buffer_bytes(self) -> int | None:
        """Receive buffer that the kernel granted; None where the bus has none."""

    def start_reader(self, listener: FrameListener) -> Reader:
        """Begin to receive; the reader closes the bus."""

    def send_now(self, can_id: int, data: bytes) -> None:
        """Send one extended data frame without waiting."""


class DrainedBus:
    """SocketCAN, read by the ticking thread."""

    stamps_are_monotonic = True

    def __init__(self, library_bus: DrainingSocketcanBus) -> None:
        self._library_bus = library_bus
        self.receive_buffer_bytes = library_bus.receive_buffer_bytes
        self.send_now = library_bus.send_now

    def start_reader(self, listener: FrameListener) -> Reader:
        """Begin to receive, when the reader is told to read."""
        return DrainingReader(self._library_bus, listener)


class PlainBus:
    """A bus that is read by a thread of its own."""

    stamps_are_monotonic = False
    receive_buffer_bytes = None

    def __init__(self, library_bus: can.BusABC) -> None:
        self._library_bus = library_bus

    def start_reader(self, listener: FrameListener) -> Reader:
        return ThreadReader(self._library_bus, listener)

    def send_now(self, can_id: int, data: bytes) -> None:
        self._library_bus.send(can.Message(arbitration_id=can_id, data=data))


def open_bus(settings: BusSettings, filters: list[Any] | None, counters: BusCounters) -> Bus:
    """Open a bus; OSError, can.CanError or ImportError where that cannot be."""
    if settings.interface == "socketcan":
        return DrainedBus(
            DrainingSocketcanBus(settings.channel, filters, settings.receive_buffer_bytes, counters)
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
