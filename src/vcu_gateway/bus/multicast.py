"""python-can's UDP multicast bus, telling our own frames from those of others.

A group gives every datagram to its sender, too, and a datagram does not name its sender. This bus
remembers what it sent last: each of its datagrams carries the time, so that no other node's is the
same to the last bit.
"""

import threading
import time
from typing import Any

from vcu_gateway.python_can import can

# isort: split
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.utils import pack_message, unpack_message

from vcu_gateway.bus.settings import BusCounters

# Of our own, a second's worth: what has not come back by then is lost.
_REMEMBERED = 64


class EchoingMulticastBus(UdpMulticastBus):
    """A multicast bus whose `Message.is_rx` is False for our own frame that has come back.

    A datagram that holds no frame is counted in `BusCounters.undecodable` and dropped.
    """

    def __init__(self, channel: str, can_filters: Any, counters: BusCounters) -> None:
        self._counters = counters
        self._sent: dict[bytes, None] = {}
        self._sending = threading.Lock()
        super().__init__(channel=channel, can_filters=can_filters)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        msg.timestamp = time.time()
        datagram = pack_message(msg)
        with self._sending:
            self._sent[datagram] = None
            if len(self._sent) > _REMEMBERED:
                del self._sent[next(iter(self._sent))]
        self._multicast.send(datagram, timeout)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        received = self._multicast.recv(timeout)
        if received is None:
            return None, False
        datagram, _, stamp_s = received
        try:
            message = unpack_message(datagram, replace={"timestamp": stamp_s}, check=True)
        except Exception:  # noqa: BLE001 - whatever the group carries
            self._counters.undecodable += 1
            return None, False
        message.is_rx = not self._is_own(datagram)  # whatever flag the datagram carries
        return message, False

    def _is_own(self, datagram: bytes) -> bool:
        """True once for each datagram that was sent."""
        with self._sending:
            return self._sent.pop(datagram, datagram) is None
