"""Reading of an open bus: python-can's Notifier on the ticking thread, or on one of its own.

A bus whose frames wait in a socket of ours (socketcan) is drained by the ticking thread: all frames
of a period cost no wake-up of their own. On any other bus the Notifier has a thread, and what that
one has received waits for the ticking thread. A listener makes the core's frames of python-can's
messages.
"""

import functools
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, cast

from vcu_gateway.bus.settings import BusCounters, BusSettings, read_clocks
from vcu_gateway.bus.socketcan import DrainingSocketcanBus
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.schedule import arrival_ns
from vcu_gateway.python_can import can
from vcu_gateway.units import NS_PER_S, NS_PER_US

# The Notifier's thread looks this often whether it is to end.
_NOTIFIER_TIMEOUT_S = 0.1


class FrameListener:
    """Hands each frame to `receive`, on the ticking thread; errors may come on another one."""

    def __init__(
        self,
        receive: Callable[[Frame], None],
        counters: BusCounters,
        lost: Callable[[str], None],
        stamps_are_monotonic: bool,
    ) -> None:
        self._receive = receive
        self._counters = counters
        self._lost = lost
        self._stamps_are_monotonic = stamps_are_monotonic
        self._clocks = read_clocks()

    def __call__(self, message: can.Message) -> None:
        """Hand one frame on, with its stamp in whole microseconds.

        No kernel and no reading of two clocks is more exact; what is below would be noise, and a
        tenth of every recording.
        """
        self._counters.received += 1
        stamp_ns = int(message.timestamp * NS_PER_S)
        if not self._stamps_are_monotonic:
            before, self._clocks = self._clocks, read_clocks()
            stamp_ns = arrival_ns(stamp_ns, before, self._clocks)
        self._receive(
            Frame(
                message.arbitration_id,
                message.data,
                stamp_ns - stamp_ns % NS_PER_US,
                message.is_extended_id,
                message.is_remote_frame,
                message.is_error_frame,
                not message.is_rx,
            )
        )

    def on_error(self, error: Exception) -> None:
        """Report a failed interface as lost; count a bug of ours, which costs its frame."""
        if isinstance(error, (OSError, can.CanError)):
            self._lost(str(error))
        else:
            self._counters.receiver_bugs += 1
            self._counters.last_bug = repr(error)


class DrainedBus:
    """SocketCAN, read by the thread that calls `read_waiting`, through the Notifier's own callback.

    The Notifier registers its callback for one frame by an event loop's `add_reader` and takes it
    back by `remove_reader`; it asks no more of a loop. This object takes the loop's place.
    Reading and closing never meet: nobody waits to read what is being closed.

    Attributes:
        stamps_are_monotonic: `Message.timestamp` is of the monotonic clock, not of the wall clock.
        receive_buffer_bytes: what the kernel granted.
        drains: times that all that waited was read, frames or none.
    """

    stamps_are_monotonic = True

    def __init__(self, library_bus: DrainingSocketcanBus) -> None:
        self.drains = 0
        self.receive_buffer_bytes = library_bus.receive_buffer_bytes
        self.send_now = library_bus.send_now
        self._library_bus = library_bus
        self._in_use = threading.Lock()
        self._receive_one: Callable[[], object] | None = None

    def start(self, listener: FrameListener) -> None:
        self._listener = listener
        self._notifier = can.Notifier(self._library_bus, [listener], loop=cast(Any, self))

    def add_reader(self, descriptor: int, callback: Callable[..., object], *arguments: Any) -> None:
        del descriptor
        self._receive_one = functools.partial(callback, *arguments)

    def remove_reader(self, descriptor: int) -> None:
        del descriptor
        self._receive_one = None

    def read_waiting(self, until_ns: int) -> int:
        """Hand on what arrived until this time; how many frames were read. It never raises."""
        if not self._in_use.acquire(blocking=False):
            return 0
        try:
            return self._drain(until_ns)
        finally:
            self._in_use.release()

    def _drain(self, until_ns: int) -> int:
        receive_one = self._receive_one
        if receive_one is None:
            return 0
        frames, more = 0, True
        while more:
            count = self._library_bus.read_batch(until_ns)
            _hand_on(receive_one, count, self._listener)
            frames, more = frames + count, self._library_bus.has_more(until_ns)
        self.drains += 1
        return frames

    def close(self) -> None:
        """Stop the Notifier, count what was never read, close the bus."""
        with self._in_use:
            self._notifier.stop()
            self._library_bus.finish()
            self._library_bus.shutdown()


class PlainBus:
    """A bus with the Notifier on a thread of its own, whose listener it is itself.

    Frames wait for `read_waiting`, errors go on at once.
    """

    stamps_are_monotonic = False
    receive_buffer_bytes = None
    drains = None

    def __init__(self, library_bus: can.BusABC) -> None:
        self._library_bus = library_bus
        self._waiting: deque[can.Message] = deque()

    def start(self, listener: FrameListener) -> None:
        self._listener = listener
        self.on_error = listener.on_error
        self._notifier = can.Notifier(self._library_bus, [self], timeout=_NOTIFIER_TIMEOUT_S)

    def __call__(self, message: can.Message) -> None:
        self._waiting.append(message)

    def read_waiting(self, until_ns: int) -> int:
        del until_ns
        count = len(self._waiting)
        _hand_on(lambda: self._listener(self._waiting.popleft()), count, self._listener)
        return count

    def send_now(self, can_id: int, data: bytes) -> None:
        self._library_bus.send(can.Message(arbitration_id=can_id, data=data))

    def close(self) -> None:
        """Stop the Notifier, then close the bus; it takes as long as a wake-up of its thread."""
        self._notifier.stop()
        self._library_bus.shutdown()


Bus = DrainedBus | PlainBus
"""One open bus; OSError or can.CanError where its interface fails.

What it has received is handed to its listener by the thread that calls `read_waiting`.
"""


def _hand_on(receive_one: Callable[[], object], count: int, listener: FrameListener) -> None:
    for _ in range(count):
        try:
            receive_one()
        except Exception as error:  # noqa: BLE001 - as the Notifier's thread does
            listener.on_error(error)


def open_bus(settings: BusSettings, filters: list[Any] | None, counters: BusCounters) -> Bus:
    """Open a bus; OSError, can.CanError or ImportError where that cannot be."""
    interface, channel = settings.interface, settings.channel
    if interface == "socketcan":
        buffer_bytes = settings.receive_buffer_bytes
        return DrainedBus(DrainingSocketcanBus(channel, filters, buffer_bytes, counters))
    if interface == "udp_multicast":
        from vcu_gateway.bus.multicast import EchoingMulticastBus

        return PlainBus(EchoingMulticastBus(channel, filters, counters))
    return PlainBus(can.Bus(channel, interface, can_filters=filters, receive_own_messages=True))
