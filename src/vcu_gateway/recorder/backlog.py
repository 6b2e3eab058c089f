"""Bounded queue of ticks between the receiver's thread and the writer's."""

import threading
from collections import deque
from typing import NamedTuple

from vcu_gateway.recorder.connection import GatewayConnection
from vcu_gateway.recording.datagram import TickParts

_ITEM_BYTES = 400
"""Of an entry's own, roughly, besides its frames and lines."""


class Received(NamedTuple):
    """Tick of a connection.

    Attributes:
        tick: None: the connection has ended.
        size: bytes in memory, roughly.
        is_urgent: it may have to be on the disk at once.
    """

    connection: GatewayConnection
    tick: TickParts | None
    size: int = _ITEM_BYTES
    is_urgent: bool = False


def received(connection: GatewayConnection, tick: TickParts, is_urgent: bool) -> Received:
    """What goes into the queue for a tick; one that may begin a drive holds its HELLO there."""
    size = _ITEM_BYTES + len(tick.frames) + len(tick.lines)
    if tick.begins_segment or not connection.handed_on:
        size += connection.hello_bytes
    return Received(connection, tick, size, is_urgent)


class Backlog:
    """Queue of what was received and is not written.

    Where it is full the oldest goes, up to the next tick that begins a segment: what follows
    can be read by itself. Neither side waits for the other.

    Attributes:
        size: bytes in it, roughly.
    """

    def __init__(self, max_bytes: int) -> None:
        self._max_bytes = max_bytes
        self._items: deque[Received] = deque()
        self._lock = threading.Lock()
        self._sizes: dict[GatewayConnection, int] = {}
        self.size = 0

    def put(self, item: Received) -> None:
        with self._lock:
            self._items.append(item)
            self._grow(item, item.size)
            # What has just come stays: with less memory than a HELLO nothing would ever be written.
            while self.size > self._max_bytes and len(self._items) > 1 and self._drop_oldest():
                pass

    def take(self) -> Received | None:
        with self._lock:
            if not self._items:
                return None
            item = self._items.popleft()
            self._grow(item, -item.size)
            return item

    def _grow(self, item: Received, size: int) -> None:
        self.size += size
        left = self._sizes.get(item.connection, 0) + size
        if left:
            self._sizes[item.connection] = left
        else:
            self._sizes.pop(item.connection, None)

    def _drop_oldest(self) -> bool:
        """Drop a connection's oldest ticks up to its next segment; False where there are none.

        It is the connection that has most in the queue: the others do not lose by it.
        Where all of them go its gateway is to connect again: that begins a segment.
        """
        most = max(self._sizes, key=lambda one: self._sizes[one])
        ticks = [
            (item, item.tick.begins_segment)
            for item in self._items
            if item.tick is not None and item.connection is most
        ]
        if not ticks:
            return False
        end = next((place for place, (_, begins) in enumerate(ticks) if place and begins), None)
        if end is None:
            most.begin_again = True
            most.forget_hello()
        dropped = {id(item): item for item, _ in ticks[:end]}
        for item in dropped.values():
            self._grow(item, -item.size)
        self._items = deque(item for item in self._items if id(item) not in dropped)
        return True
