"""Receiver: python-can messages to the core's frames."""

from collections.abc import Callable

from vcu_gateway.bus.settings import BusCounters
from vcu_gateway.bus.timestamps import read_clocks
from vcu_gateway.core.arrival_time import arrival_ns
from vcu_gateway.core.frame import Frame
from vcu_gateway.python_can import can
from vcu_gateway.units import NS_PER_S, NS_PER_US


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
            stamp_ns = self._to_monotonic(stamp_ns)
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

    def _to_monotonic(self, stamp_wall_ns: int) -> int:
        before, self._clocks = self._clocks, read_clocks()
        return arrival_ns(stamp_wall_ns, before, self._clocks)

    def on_error(self, error: Exception) -> None:
        """Report a failed interface as lost; count a bug of ours, which costs its frame."""
        if isinstance(error, (OSError, can.CanError)):
            self._lost(str(error))
        else:
            self._counters.receiver_bugs += 1
            self._counters.last_bug = repr(error)

    def stop(self) -> None:
        """Nothing to flush."""
