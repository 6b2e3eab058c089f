"""Synchronous client: `Client`, its `Subscription` and their `Connection`; for threads."""

import contextlib
import itertools
import os
import socket
import threading
import time
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Self, TypeVar

from vcu_gateway.api import results
from vcu_gateway.client import jsonrpc
from vcu_gateway.client.calls import Call, selection, subscribing, update_in, update_timeout_s
from vcu_gateway.client.errors import ApiError, ApiTimeoutError, DisconnectedError, GarbledError
from vcu_gateway.client.jsonrpc import connect, default_socket_path
from vcu_gateway.client.sync_demand import DemandOwner

ResultT = TypeVar("ResultT")

_READ_BYTES = 65536
_CONNECT_TIMEOUT_S = 2.0  # The gateway accepts a hundred connections a second.


class Connection:
    """JSON-RPC connection; each step waits until a deadline, then raises TimeoutError.

    Deadlines are in time.monotonic().
    """

    def __init__(self, path: Path) -> None:
        self._socket = connect(path, _CONNECT_TIMEOUT_S)
        self._decoder = jsonrpc.MessageDecoder()
        self._received: deque[jsonrpc.Incoming] = deque()
        self._closed = False

    def request(self, request_id: int, call: Call[ResultT], deadline_s: float) -> ResultT:
        """Send one request and return its result; an error is raised."""
        line = jsonrpc.request(request_id, call.method, call.params)
        sent = self.send(line, deadline_s)
        # A gateway that closed before it had the whole request may still have said why.
        return call.result(self._response(request_id, call, deadline_s), sent=sent)

    def _response(
        self, request_id: int, call: Call[ResultT], deadline_s: float
    ) -> jsonrpc.Response | None:
        """The response to this request; None where the connection ended first."""
        try:
            while (message := self.receive(deadline_s)) is not None:
                if isinstance(message, jsonrpc.Response) and message.concerns(request_id):
                    return message
        except GarbledError as error:
            raise call.garbled(error) from error
        return None

    def send(self, data: bytes, deadline_s: float) -> bool:
        """Send all bytes; False where the gateway closed before it had them."""
        self._socket.settimeout(_remaining_s(deadline_s))
        try:
            self._socket.sendall(data)
        except ConnectionError:
            return False
        return True

    def read(self, deadline_s: float) -> bytes:
        """Some bytes; none once the connection has ended."""
        if self._closed:
            return b""
        self._socket.settimeout(_remaining_s(deadline_s))
        try:
            return self._socket.recv(_READ_BYTES)
        except ConnectionError:
            return b""

    def receive(self, deadline_s: float) -> jsonrpc.Incoming | None:
        """The next message; None once the connection has ended."""
        while not self._received:
            data = self.read(deadline_s)
            if not data:
                return None
            self._received += self._decoder.feed(data)
        return self._received.popleft()

    def shutdown(self) -> None:
        """End the connection for a thread that waits on it; `close` is still due."""
        with contextlib.suppress(OSError):  # It had ended.
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close and drop what was not received; again, it does nothing."""
        self._closed = True
        self._received.clear()
        self._socket.close()


class Subscription:
    """Iterator of state updates on a connection of its own; it ends with that connection.

    `update["lost"]` counts what was not sent because this reader was slow. ApiTimeoutError
    where an update is overdue by the client's timeout. Use `with` where the loop may end early.
    """

    def __init__(
        self, path: Path, call: Call[results.Subscribed], rate_hz: float, timeout_s: float
    ) -> None:
        self._update_timeout_s = update_timeout_s(rate_hz, timeout_s)
        self._reading = threading.Lock()
        self._connection = Connection(path)
        try:
            self._connection.request(1, call, time.monotonic() + timeout_s)
        except BaseException as error:
            self._connection.close()
            if isinstance(error, TimeoutError):
                raise call.timed_out(timeout_s) from None
            raise

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> results.Update:
        with self._reading:
            update = self._next_update()
            if update is None:
                self._connection.close()
                raise StopIteration
            return update

    def _next_update(self) -> results.Update | None:
        """The next update; None once the connection has ended."""
        try:
            return self._receive_update(time.monotonic() + self._update_timeout_s)
        except TimeoutError:
            raise ApiTimeoutError(f"no update within {self._update_timeout_s:g} s") from None
        except GarbledError:
            self._connection.close()
            raise

    def _receive_update(self, deadline_s: float) -> results.Update | None:
        while (message := self._connection.receive(deadline_s)) is not None:
            if (update := update_in(message)) is not None:
                return update
        return None

    def close(self) -> None:
        """End it, from any thread; one that waits for an update gets no further one."""
        self._connection.shutdown()
        if self._reading.acquire(blocking=False):
            self._connection.close()
            self._reading.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class Client:
    """Synchronous client of a running gateway; threads may share one, their calls take turns.

    It connects on first use and again after a break. A read-only request is then sent once
    more; one that changes something is not, and raises DisconnectedError, unless the gateway
    certainly never got it, or it stops the vehicle (`estop`, `disarm`).

    Every method raises UnreachableError, ApiTimeoutError, DisconnectedError or ApiError.
    """

    def __init__(
        self, socket_path: str | os.PathLike[str] | None = None, timeout_s: float = 2.0
    ) -> None:
        self.socket_path = Path(socket_path) if socket_path is not None else default_socket_path()
        self.timeout_s = timeout_s
        self._lock = threading.Lock()
        self._request_ids = itertools.count(1)
        self._connection: Connection | None = None

    def state(self, messages: Iterable[str] | None = None) -> results.State:
        """Received signals and sent commands now, of these messages or of all."""
        return self.call(Call("state.get", selection(messages)))

    def subscribe(
        self, messages: Iterable[str] | None = None, rate_hz: float = 10.0
    ) -> Subscription:
        """The state `rate_hz` times a second, 0.1 to 50, on a connection of its own."""
        call = subscribing(messages, rate_hz)
        return Subscription(self.socket_path, call, rate_hz, self.timeout_s)

    def why(self) -> results.Why:
        """Reasons why the vehicle does or does not move, and what to do next."""
        return self.call(Call("why"))

    def health(self) -> results.Health:
        """State of the gateway itself: bus, ticks, counters, versions."""
        return self.call(Call("health"))

    def events(self, limit: int = 50) -> results.Events:
        """The latest events, 1 to 200 of them."""
        return self.call(Call("events", {"limit": limit}))

    def config(self) -> results.ConfigInEffect:
        """The configuration in effect."""
        return self.call(Call("config.get"))

    def protocol(self) -> results.Protocol:
        """Messages and signals of the bus."""
        return self.call(Call("protocol.get"))

    def arm(self) -> results.Granted:
        """From standby to active; needs a fresh demand without throttle."""
        return self.call(Call("arm"))

    def disarm(self) -> results.Granted:
        """From active to standby."""
        return self.call(Call("disarm"))

    def reset(self, level: results.FaultClassName = "driver") -> results.Granted:
        """From fault to starting."""
        return self.call(Call("reset", {"level": level}))

    def set_drive_mode(
        self, mode: str, level: results.FaultClassName = "driver"
    ) -> results.Granted:
        """Ask for a drive mode; it waits for the pedal's release where it would make a step."""
        return self.call(Call("drive_mode.set", {"mode": mode, "level": level}))

    def tuning(self) -> results.TuningNow:
        """Drive mode, and where the vehicle is on each curve."""
        return self.call(Call("tuning.get"))

    def estop(self) -> results.Granted:
        """Emergency stop: cut the power of both controllers until a reset at service level."""
        return self.call(Call("estop"))

    def reload(self) -> results.Reloaded:
        """Read the configuration file again, all of it or nothing."""
        return self.call(Call("config.reload"))

    def demand(self, source: str, *, ttl_ms: int = 200, hold_s: float | None = 0.5) -> DemandOwner:
        """Demand throttle and brake as `source`; see DemandOwner."""
        return DemandOwner(self.socket_path, source, ttl_ms, hold_s, self.timeout_s)

    def call(self, call: Call[ResultT]) -> ResultT:
        """Send any request and return its result."""
        deadline_s = time.monotonic() + self.timeout_s
        if not self._lock.acquire(timeout=self.timeout_s):
            raise ApiTimeoutError(f"{call.method} was not sent: other threads' requests hang")
        try:
            return self._call_with_retry(call, deadline_s)
        except TimeoutError:
            raise call.timed_out(self.timeout_s) from None
        finally:
            self._lock.release()

    def _call_with_retry(self, call: Call[ResultT], deadline_s: float) -> ResultT:
        try:
            return self._call_once(call, deadline_s)
        except DisconnectedError as error:
            if not call.may_retry(error):
                raise
        return self._call_once(call, deadline_s)

    def _call_once(self, call: Call[ResultT], deadline_s: float) -> ResultT:
        self._connection = self._connection or Connection(self.socket_path)
        try:
            return self._connection.request(next(self._request_ids), call, deadline_s)
        except ApiError:
            raise
        except BaseException:
            # Whatever was not an answer leaves the connection in an unknown state.
            self._disconnect()
            raise

    def _disconnect(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def close(self) -> None:
        """Close the connection; the next call opens a new one."""
        with self._lock:
            self._disconnect()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _remaining_s(deadline_s: float) -> float:
    remaining_s = deadline_s - time.monotonic()
    if remaining_s <= 0:
        raise TimeoutError
    return remaining_s
