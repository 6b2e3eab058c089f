"""Receiver: takes the datagrams of every connected gateway; it never waits for the disk.

Backlog: bounded queue of ticks between the receiver's thread and the writer's.
"""

import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Container, Sequence
from typing import NamedTuple

from vcu_gateway.rate_limit import TokenBucket
from vcu_gateway.recorder.connection import BUFFER_BYTES, GatewayConnection
from vcu_gateway.recorder.senders import Refusals, RunOwners, Sender, TapListener, sender_of
from vcu_gateway.recording.datagram import DatagramError, TickParts, may_be_urgent
from vcu_gateway.units import NS_PER_S

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


_MOST_CONNECTIONS = 16
_MOST_WITHOUT_HELLO = 8
_MOST_UNFINISHED_BYTES = 2 << 20
_HELLO_S = 5.0
_QUIET_S = 5.0
_RUNS = 2 * NS_PER_S, 16
"""New ones of one process, one in so long, and at once: each makes a folder, which waits."""
_MOST_SENDERS = 64
_MOST_AT_ONCE = 200
_MOST_OF_ONE = 20


class DatagramReceiver:
    """Connections and what they send.

    Attributes:
        urgent_s: when the latest came that was not to wait, on the monotonic clock.
    """

    def __init__(
        self,
        listener: TapListener,
        wake_up: socket.socket,
        backlog: Backlog,
        urgent: Callable[[], None],
        trusted: Container[int],
        refusals: Refusals,
    ) -> None:
        """`wake_up` ends a wait when it can be read; `urgent` is called for what is not to wait.

        `trusted` are the ids of the users who may hand over.
        """
        self.connections: list[GatewayConnection] = []
        self.urgent_s = 0.0
        self._listener = listener
        self._wake_up = wake_up
        self._backlog = backlog
        self._urgent = urgent
        self._trusted = trusted
        self._refusals = refusals
        self._owners = RunOwners()
        self._runs: dict[Sender, tuple[set[str], TokenBucket]] = {}
        self._buffer = bytearray(BUFFER_BYTES)
        self._selector = selectors.DefaultSelector()
        self._newcomers = selectors.DefaultSelector()
        for selector in (self._selector, self._newcomers):
            selector.register(listener.sock, selectors.EVENT_READ)
            selector.register(wake_up, selectors.EVENT_READ)

    def receive(self, timeout_s: float) -> None:
        """Wait for something, for at most this time, and take all that has come."""
        for _ in range(_MOST_AT_ONCE):
            ready = self._selector.select(timeout_s)
            self._take(ready)
            if not ready:
                return
            timeout_s = 0.0

    def _take(self, ready: Sequence[tuple[selectors.SelectorKey, int]]) -> None:
        for key, _ in ready:
            if key.fileobj is self._listener.sock:
                self._accept()
            elif key.fileobj is self._wake_up:
                self._wake_up.recv(4096)
            else:
                self._read(key.data)
        late_s = time.monotonic() - _HELLO_S
        for connection in list(self.connections):
            if connection.fault is not None:
                self._refuse(connection, connection.fault)
            elif connection.begin_again:
                self._end(connection)
            elif connection.hello is None and connection.begun_s < late_s:
                late = DatagramError(f"no whole HELLO within {_HELLO_S:.0f} s", "hello_late")
                self._refuse(connection, late)

    def gather(self, limit_s: float) -> None:
        """Take what has come when this time is over, somebody connects, or a signal comes."""
        self._newcomers.select(limit_s)
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
            sender = sender_of(sock)
        except OSError:
            return
        if sender.uid not in self._trusted:
            what = f"{sender} may not hand over a drive: turned away (--gateway-user)"
            self._refusals.note("sender", what)
        elif not self._made_room():
            what = f"more than {_MOST_CONNECTIONS} connections: {sender} is turned away"
            self._refusals.note("connections", what)
        else:
            sock.setblocking(False)
            connection = GatewayConnection(sock, sender)
            self.connections.append(connection)
            self._selector.register(connection, selectors.EVENT_READ, connection)
            return
        sock.close()

    def _made_room(self) -> bool:
        """True where one more connection has room; one that only takes room is ended for it."""
        without = [one for one in self.connections if one.hello is None]
        if len(without) >= _MOST_WITHOUT_HELLO:
            self._refuse(without[0], DatagramError("too many without a HELLO", "connections"))
        if len(self.connections) < _MOST_CONNECTIONS:
            return True
        quiet = min(self.connections, key=lambda one: one.latest_s)
        if time.monotonic() - quiet.latest_s < _QUIET_S:
            return False
        self._refuse(quiet, DatagramError("too many connections, and it is quiet", "connections"))
        return True

    def _read(self, connection: GatewayConnection) -> None:
        """Take what waits, some datagrams at most; the selector tells of more."""
        for _ in range(_MOST_OF_ONE):
            if connection.begin_again:
                return  # it is about to end
            try:
                tick = connection.receive(self._buffer)
                if tick is None:
                    self._check_hello(connection)
                else:
                    self._put(connection, tick)
            except BlockingIOError:
                return
            except DatagramError as error:
                self._refuse(connection, error)
                return
            except (OSError, EOFError) as error:
                connection.ended_by_gateway = isinstance(error, EOFError)
                self._end(connection)
                return
            except Exception as error:  # noqa: BLE001 - its own connection pays
                self._refuse(connection, DatagramError(repr(error)[:200], "fault"))
                return

    def _check_hello(self, connection: GatewayConnection) -> None:
        """DatagramError where its run is another's, or the HELLOs take too much memory."""
        hello = connection.hello
        if hello is None:
            if sum(one.hello_text.size for one in self.connections) > _MOST_UNFINISHED_BYTES:
                raise DatagramError("the unfinished HELLOs are too long together", "hello")
            return
        other = self._owners.other(hello["run"], connection.sender)
        if other is not None:
            raise DatagramError(f"its run is that of {other}, which lives", "run")
        self._count_run(connection.sender, hello["run"])

    def _count_run(self, sender: Sender, run: str) -> None:
        """DatagramError where one process brings too many runs; a gateway has one."""
        if sender not in self._runs:
            for old in list(self._runs)[: 1 - _MOST_SENDERS]:
                del self._runs[old]
            self._runs[sender] = set(), TokenBucket(*_RUNS, time.monotonic_ns())
        known, allowance = self._runs[sender]
        if run not in known and not allowance.taken(time.monotonic_ns()):
            raise DatagramError("too many runs of one process", "rate")
        if len(known) < _RUNS[1]:
            known.add(run)

    def _put(self, connection: GatewayConnection, tick: TickParts) -> None:
        is_urgent = may_be_urgent(tick.lines)
        self._backlog.put(received(connection, tick, is_urgent))
        connection.handed_on = True
        if is_urgent:
            self.urgent_s = time.monotonic()
            self._urgent()

    def _refuse(self, connection: GatewayConnection, error: DatagramError) -> None:
        if connection in self.connections:
            what = f"the connection of {connection.sender} is closed: {error}"
            self._refusals.note(error.kind, what)
            self._end(connection)

    def _end(self, connection: GatewayConnection) -> None:
        if connection in self.connections:
            self.connections.remove(connection)
            self._selector.unregister(connection)
            connection.close()
            if connection.handed_on:
                self._backlog.put(Received(connection, None))
                self._urgent()

    def close(self) -> None:
        for connection in list(self.connections):
            self._end(connection)
        self._selector.close()
        self._newcomers.close()
