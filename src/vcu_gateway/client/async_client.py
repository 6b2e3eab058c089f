"""Asynchronous client: `AsyncClient`, its `AsyncSubscription` and their `AsyncConnection`."""

import asyncio
import contextlib
import itertools
import os
import socket
from collections import deque
from collections.abc import Iterable
from pathlib import Path
from typing import Self, TypeVar

from vcu_gateway.api import results
from vcu_gateway.client import jsonrpc
from vcu_gateway.client.async_demand import AsyncDemandOwner
from vcu_gateway.client.calls import Call, selection, subscribing, update_in, update_timeout_s
from vcu_gateway.client.errors import ApiError, ApiTimeoutError, DisconnectedError, GarbledError
from vcu_gateway.client.jsonrpc import connect, default_socket_path

ResultT = TypeVar("ResultT")

_READ_BYTES = 65536


class AsyncConnection:
    """JSON-RPC connection without a task or transport: the coroutine that waits is the reader.

    Timeouts are the caller's.
    """

    def __init__(self, path: Path) -> None:
        self._socket = connect(path)
        self._decoder = jsonrpc.MessageDecoder()
        self._received: deque[jsonrpc.Incoming] = deque()
        self._closed = False
        self._reading = False

    async def request(self, request_id: int, call: Call[ResultT]) -> ResultT:
        """Send one request and return its result; an error is raised."""
        sent = await self.send(jsonrpc.request(request_id, call.method, call.params))
        # A gateway that closed before it had the whole request may still have said why.
        return call.result(await self._response(request_id, call), sent=sent)

    async def _response(self, request_id: int, call: Call[ResultT]) -> jsonrpc.Response | None:
        """The response to this request; None where the connection ended first."""
        try:
            while (message := await self.receive()) is not None:
                if isinstance(message, jsonrpc.Response) and message.concerns(request_id):
                    return message
        except GarbledError as error:
            raise call.garbled(error) from error
        return None

    async def send(self, data: bytes) -> bool:
        """Send all bytes; False where the gateway closed before it had them."""
        try:
            await asyncio.get_running_loop().sock_sendall(self._socket, data)
        except ConnectionError:
            return False
        return True

    async def read(self) -> bytes:
        """Some bytes; none once the connection has ended."""
        if self._closed:
            return b""
        self._reading = True
        try:
            return await asyncio.get_running_loop().sock_recv(self._socket, _READ_BYTES)
        except ConnectionError:
            return b""
        finally:
            self._reading = False
            if self._closed:
                self._socket.close()

    async def receive(self) -> jsonrpc.Incoming | None:
        """The next message; None once the connection has ended."""
        while not self._received:
            data = await self.read()
            if not data:
                return None
            self._received += self._decoder.feed(data)
        return self._received.popleft()

    def close(self) -> None:
        """Close and drop what was not received; again, it does nothing."""
        self._closed = True
        self._received.clear()
        if not self._reading:
            self._socket.close()
            return
        with contextlib.suppress(OSError):  # Wakes the coroutine that reads, which closes.
            self._socket.shutdown(socket.SHUT_RDWR)


class AsyncSubscription:
    """Async iterator of state updates on a connection of its own; it ends with that connection.

    It connects with the first update. `update["lost"]` counts what was not sent because this
    reader was slow. ApiTimeoutError where an update is overdue by the client's timeout. Use
    `async with` where the loop may end early.
    """

    def __init__(
        self, path: Path, call: Call[results.Subscribed], rate_hz: float, timeout_s: float
    ) -> None:
        self._path = path
        self._call = call
        self._timeout_s = timeout_s
        self._update_timeout_s = update_timeout_s(rate_hz, timeout_s)
        self._connection: AsyncConnection | None = None

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> results.Update:
        connection = self._connection or await self._connect()
        try:
            async with asyncio.timeout(self._update_timeout_s):
                update = await _receive_update(connection)
        except TimeoutError:
            raise ApiTimeoutError(f"no update within {self._update_timeout_s:g} s") from None
        except GarbledError:
            connection.close()
            raise
        if update is None:
            connection.close()
            raise StopAsyncIteration
        return update

    async def _connect(self) -> AsyncConnection:
        self._connection = AsyncConnection(self._path)
        try:
            async with asyncio.timeout(self._timeout_s):
                await self._connection.request(1, self._call)
        except BaseException as error:
            self.close()
            if isinstance(error, TimeoutError):
                raise self._call.timed_out(self._timeout_s) from None
            raise
        return self._connection

    def close(self) -> None:
        """End it, from any task; one that waits for an update gets no further one."""
        if self._connection is not None:
            self._connection.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc: object) -> None:
        self.close()


class AsyncClient:
    """Asyncio client of a running gateway; tasks may share one, their calls take turns.

    It connects on first use and again after a break. A read-only request is then sent once
    more; one that changes something is not, and raises DisconnectedError, unless the gateway
    certainly never got it, or it stops the vehicle (`estop`, `disarm`). It starts no task;
    only a demand has one.

    Every method raises UnreachableError, ApiTimeoutError, DisconnectedError or ApiError.
    """

    def __init__(
        self, socket_path: str | os.PathLike[str] | None = None, timeout_s: float = 2.0
    ) -> None:
        self.socket_path = Path(socket_path) if socket_path is not None else default_socket_path()
        self.timeout_s = timeout_s
        self._lock = asyncio.Lock()
        self._request_ids = itertools.count(1)
        self._connection: AsyncConnection | None = None

    async def state(self, messages: Iterable[str] | None = None) -> results.State:
        """Received signals and sent commands now, of these messages or of all."""
        return await self.call(Call("state.get", selection(messages)))

    def subscribe(
        self, messages: Iterable[str] | None = None, rate_hz: float = 10.0
    ) -> AsyncSubscription:
        """The state `rate_hz` times a second, 0.1 to 50, on a connection of its own."""
        call = subscribing(messages, rate_hz)
        return AsyncSubscription(self.socket_path, call, rate_hz, self.timeout_s)

    async def why(self) -> results.Why:
        """Reasons why the vehicle does or does not move, and what to do next."""
        return await self.call(Call("why"))

    async def health(self) -> results.Health:
        """State of the gateway itself: bus, ticks, counters, versions."""
        return await self.call(Call("health"))

    async def events(self, limit: int = 50) -> results.Events:
        """The latest events, 1 to 200 of them."""
        return await self.call(Call("events", {"limit": limit}))

    async def config(self) -> results.ConfigInEffect:
        """The configuration in effect."""
        return await self.call(Call("config.get"))

    async def protocol(self) -> results.Protocol:
        """Messages and signals of the bus."""
        return await self.call(Call("protocol.get"))

    async def arm(self) -> results.Granted:
        """From standby to active; needs a fresh demand without throttle."""
        return await self.call(Call("arm"))

    async def disarm(self) -> results.Granted:
        """From active to standby."""
        return await self.call(Call("disarm"))

    async def reset(self, level: results.FaultClassName = "driver") -> results.Granted:
        """From fault to starting."""
        return await self.call(Call("reset", {"level": level}))

    async def set_drive_mode(
        self, mode: str, level: results.FaultClassName = "driver"
    ) -> results.Granted:
        """Ask for a drive mode; it waits for the pedal's release where it would make a step."""
        return await self.call(Call("drive_mode.set", {"mode": mode, "level": level}))

    async def tuning(self) -> results.TuningNow:
        """Drive mode, and where the vehicle is on each curve."""
        return await self.call(Call("tuning.get"))

    async def estop(self) -> results.Granted:
        """Emergency stop: cut the power of both controllers until a reset at service level."""
        return await self.call(Call("estop"))

    async def reload(self) -> results.Reloaded:
        """Read the configuration file again, all of it or nothing."""
        return await self.call(Call("config.reload"))

    def demand(
        self, source: str, *, ttl_ms: int = 200, hold_s: float | None = 0.5
    ) -> AsyncDemandOwner:
        """Demand throttle and brake as `source`; see AsyncDemandOwner."""
        return AsyncDemandOwner(self.socket_path, source, ttl_ms, hold_s, self.timeout_s)

    async def call(self, call: Call[ResultT]) -> ResultT:
        """Send any request and return its result."""
        try:
            async with asyncio.timeout(self.timeout_s), self._lock:
                return await self._call_with_retry(call)
        except TimeoutError:
            raise call.timed_out(self.timeout_s) from None

    async def _call_with_retry(self, call: Call[ResultT]) -> ResultT:
        try:
            return await self._call_once(call)
        except DisconnectedError as error:
            if not call.may_retry(error):
                raise
        return await self._call_once(call)

    async def _call_once(self, call: Call[ResultT]) -> ResultT:
        self._connection = self._connection or AsyncConnection(self.socket_path)
        try:
            return await self._connection.request(next(self._request_ids), call)
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

    async def close(self) -> None:
        """Close the connection; the next call opens a new one."""
        async with self._lock:
            self._disconnect()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.close()


async def _receive_update(connection: AsyncConnection) -> results.Update | None:
    """The next update; None once the connection has ended."""
    while (message := await connection.receive()) is not None:
        if (update := update_in(message)) is not None:
            return update
    return None
