"""Receiver: takes the datagrams of every connected gateway; it never waits for the disk."""

import selectors
import socket
import time
from collections.abc import Callable, Sequence

from vcu_gateway.drive_format.datagram import DatagramError, TickParts
from vcu_gateway.recorder import triggers
from vcu_gateway.recorder.backlog import Backlog, Received, received
from vcu_gateway.recorder.connection import GatewayConnection, new_buffer
from vcu_gateway.recorder.listener import TapListener

_MOST_CONNECTIONS = 16
_MOST_AT_ONCE = 200
_MOST_OF_ONE = 20
_WAKE_UP_BYTES = 4096


class DatagramReceiver:
    """Connections and what they send.

    Attributes:
        connections: those that are open.
        urgent_s: when the latest came that was not to wait, on the monotonic clock.
    """

    def __init__(
        self,
        listener: TapListener,
        wake_up: socket.socket,
        backlog: Backlog,
        urgent: Callable[[], None],
        say: Callable[[str], None],
    ) -> None:
        """`wake_up` ends a wait when it can be read; `urgent` is called for what is not to wait."""
        self.connections: list[GatewayConnection] = []
        self.urgent_s = 0.0
        self._listener = listener
        self._wake_up = wake_up
        self._backlog = backlog
        self._urgent = urgent
        self._say = say
        self._buffer = new_buffer()
        self._selector = selectors.DefaultSelector()
        self._selector.register(listener.sock, selectors.EVENT_READ)
        self._selector.register(wake_up, selectors.EVENT_READ)

    def receive(self, timeout_s: float) -> None:
        """Wait for something, for at most this time, and take all that has come."""
        for _ in range(_MOST_AT_ONCE):
            ready = self._selector.select(timeout_s)
            if not ready:
                return
            self._take(ready)
            timeout_s = 0.0

    def _take(self, ready: Sequence[tuple[selectors.SelectorKey, int]]) -> None:
        for key, _ in ready:
            if key.fileobj is self._listener.sock:
                self._accept()
            elif key.fileobj is self._wake_up:
                self._wake_up.recv(_WAKE_UP_BYTES)
            else:
                self._read(key.data)
        for connection in [one for one in self.connections if one.begin_again]:
            self._end(connection)

    def look(self) -> None:
        """Take what has come, without waiting; connections are not asked whether something has."""
        for connection in list(self.connections):
            self._read(connection)
        self._take(self._selector.select(0.0))

    def receive_rest(self, limit_s: float) -> None:
        """Take what the gateways still send until they have closed, for at most this time."""
        end_s = time.monotonic() + limit_s
        self.receive(0.0)  # who has connected a moment ago
        while self.connections and (left_s := end_s - time.monotonic()) > 0:
            self.receive(left_s)

    def _accept(self) -> None:
        try:
            sock, _ = self._listener.sock.accept()
        except OSError:
            return
        if len(self.connections) >= _MOST_CONNECTIONS:
            self._say(f"more than {_MOST_CONNECTIONS} connections; one is turned away")
            sock.close()
            return
        sock.setblocking(False)
        connection = GatewayConnection(sock)
        self.connections.append(connection)
        self._selector.register(connection, selectors.EVENT_READ, connection)

    def _read(self, connection: GatewayConnection) -> None:
        """Take what waits, some datagrams at most; the selector tells of more."""
        for _ in range(_MOST_OF_ONE):
            try:
                tick = connection.receive(self._buffer)
            except BlockingIOError:
                return
            except DatagramError as error:
                self._say(f"a connection is closed: {error}")
                self._end(connection)
                return
            except (OSError, EOFError) as error:
                connection.ended_by_gateway = isinstance(error, EOFError)
                self._end(connection)
                return
            if tick is not None:
                self._put(connection, tick)

    def _put(self, connection: GatewayConnection, tick: TickParts) -> None:
        is_urgent = triggers.may_be_urgent(tick.lines)
        self._backlog.put(received(connection, tick, is_urgent))
        if is_urgent:
            self.urgent_s = time.monotonic()
            self._urgent()

    def _end(self, connection: GatewayConnection) -> None:
        if connection in self.connections:
            self.connections.remove(connection)
            self._selector.unregister(connection)
            connection.close()
            self._backlog.put(Received(connection, None))
            self._urgent()

    def close(self) -> None:
        """End every connection."""
        for connection in list(self.connections):
            self._end(connection)
        self._selector.close()
