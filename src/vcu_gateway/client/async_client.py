"""The client for asyncio."""

import asyncio
import itertools
import os
from collections.abc import Iterable
from pathlib import Path
from types import TracebackType
from typing import Literal, Self, TypeVar

from vcu_gateway.api import results
from vcu_gateway.client import calls, metrics_page
from vcu_gateway.client.async_connection import AsyncConnection, ask
from vcu_gateway.client.async_demand import AsyncDemandOwner
from vcu_gateway.client.async_subscription import AsyncSubscription
from vcu_gateway.client.calls import Call
from vcu_gateway.client.connect import default_socket_path
from vcu_gateway.client.errors import ApiError, ApiTimeoutError, DisconnectedError

ResultT = TypeVar("ResultT")


class AsyncClient:
    """Talks to the gateway; any number of tasks may share one, they take turns.

    It connects on first use and again after a break. A request that only tells is then sent
    once more; one that changes something is not, and raises DisconnectedError, unless it is
    certain that the gateway never got it, or it stops the vehicle (`estop`, `disarm`). It
    starts no task; only a demand has one.

    Every method raises UnreachableError, ApiTimeoutError, DisconnectedError or ApiError.
    """

    def __init__(
        self, socket_path: str | os.PathLike[str] | None = None, timeout_s: float = 2.0
    ) -> None:
        self.socket_path = Path(socket_path) if socket_path is not None else default_socket_path()
        self.timeout_s = timeout_s
        self._turn = asyncio.Lock()
        self._request_ids = itertools.count(1)
        self._connection: AsyncConnection | None = None

    async def state(self, messages: Iterable[str] | None = None) -> results.State:
        """What is known and commanded now, of these messages or of all."""
        return await self.call(calls.state(messages))

    def subscribe(
        self, messages: Iterable[str] | None = None, rate_hz: float = 10.0
    ) -> AsyncSubscription:
        """The state again and again, 0.1 to 50 times a second, on a connection of its own."""
        call = calls.subscribe(messages, rate_hz)
        return AsyncSubscription(self.socket_path, call, rate_hz, self.timeout_s)

    async def why(self) -> results.Why:
        """Why the vehicle does or does not move, and what to do next."""
        return await self.call(calls.why())

    async def health(self) -> results.Health:
        """How the gateway itself fares: bus, ticks, counters, versions."""
        return await self.call(calls.health())

    async def events(self, limit: int = 50) -> results.Events:
        """The latest events, 1 to 200 of them."""
        return await self.call(calls.events(limit))

    async def config(self) -> results.ConfigInEffect:
        """The configuration in effect."""
        return await self.call(calls.config())

    async def protocol(self) -> results.Protocol:
        """The bus's messages and signals."""
        return await self.call(calls.protocol())

    async def arm(self) -> results.Granted:
        """From standby to active; needs a fresh demand without throttle."""
        return await self.call(calls.arm())

    async def disarm(self) -> results.Granted:
        """From active to standby."""
        return await self.call(calls.disarm())

    async def reset(self, level: Literal["driver", "service"] = "driver") -> results.Granted:
        """From fault to starting."""
        return await self.call(calls.reset(level))

    async def estop(self) -> results.Granted:
        """Cut the power of both controllers, until a reset at service level."""
        return await self.call(calls.estop())

    async def reload(self) -> results.Reloaded:
        """Let the gateway read its configuration file again, all of it or nothing."""
        return await self.call(calls.reload())

    def demand(
        self, source: str, *, ttl_ms: int = 200, hold_s: float | None = 0.5
    ) -> AsyncDemandOwner:
        """Ask for throttle and brake in this name; see AsyncDemandOwner."""
        return AsyncDemandOwner(self.socket_path, source, ttl_ms, hold_s, self.timeout_s)

    async def metrics(self) -> str:
        """The metrics in Prometheus's text format."""
        connection = AsyncConnection(self.socket_path)
        try:
            async with asyncio.timeout(self.timeout_s):
                page = await _page(connection)
        except TimeoutError:
            sentence = f"no page of metrics within {self.timeout_s:g} s"
            raise ApiTimeoutError(sentence) from None
        finally:
            connection.close()
        return page.text()

    async def call(self, call: Call[ResultT]) -> ResultT:
        """Send any request of `calls` and return its result."""
        try:
            async with asyncio.timeout(self.timeout_s), self._turn:
                return await self._answered(call)
        except TimeoutError:
            raise call.late(self.timeout_s) from None

    async def _answered(self, call: Call[ResultT]) -> ResultT:
        try:
            return await self._once(call)
        except DisconnectedError as broken:
            if not call.may_go_again(broken):
                raise
        return await self._once(call)

    async def _once(self, call: Call[ResultT]) -> ResultT:
        self._connection = self._connection or AsyncConnection(self.socket_path)
        try:
            return await ask(self._connection, next(self._request_ids), call)
        except ApiError:
            raise
        except BaseException:
            # Whatever was not an answer leaves the connection in an unknown state.
            self._drop()
            raise

    def _drop(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    async def close(self) -> None:
        """Close the connection; the next call opens a new one."""
        async with self._turn:
            self._drop()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()


async def _page(connection: AsyncConnection) -> metrics_page.Page:
    """All that the gateway answers before it closes."""
    await connection.send(metrics_page.REQUEST)
    page = metrics_page.Page()
    while data := await connection.read():
        page.feed(data)
    return page
