"""The state again and again, for asyncio."""

import asyncio
from pathlib import Path
from types import TracebackType
from typing import Self, cast

from vcu_gateway.api import results
from vcu_gateway.client import jsonrpc
from vcu_gateway.client.async_connection import AsyncConnection, ask
from vcu_gateway.client.calls import Call
from vcu_gateway.client.errors import ApiTimeoutError, GarbledError

_LOWEST_RATE_HZ = 0.1


class AsyncSubscription:
    """An async iterator of updates with a connection of its own; it ends with that connection.

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
        self._patience_s = timeout_s + 1 / max(rate_hz, _LOWEST_RATE_HZ)
        self._connection: AsyncConnection | None = None

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> results.Update:
        connection = self._connection or await self._begin()
        try:
            async with asyncio.timeout(self._patience_s):
                update = await _update(connection)
        except TimeoutError:
            raise ApiTimeoutError(f"no update within {self._patience_s:g} s") from None
        except GarbledError:
            connection.close()
            raise
        if update is None:
            connection.close()
            raise StopAsyncIteration
        return update

    async def _begin(self) -> AsyncConnection:
        self._connection = AsyncConnection(self._path)
        try:
            async with asyncio.timeout(self._timeout_s):
                await ask(self._connection, 1, self._call)
        except BaseException as error:
            self.close()
            if isinstance(error, TimeoutError):
                raise self._call.late(self._timeout_s) from None
            raise
        return self._connection

    def close(self) -> None:
        """End it, from any task; one that waits for an update gets no further one."""
        if self._connection is not None:
            self._connection.close()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


async def _update(connection: AsyncConnection) -> results.Update | None:
    """The next one; None once the connection has ended."""
    while (incoming := await connection.receive()) is not None:
        if isinstance(incoming, jsonrpc.Notification) and incoming.method == "state.update":
            return cast(results.Update, incoming.params)
    return None
