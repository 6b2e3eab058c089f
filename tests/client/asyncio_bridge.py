"""Adapter that gives the asyncio client the synchronous one's methods: one test tries both."""

import asyncio
from collections.abc import Iterator
from typing import Any

from vcu_gateway.client import AsyncClient

_END = object()


class Bridged:
    """Synchronous methods, each of which runs the asyncio one in an event loop of its own."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._runner = asyncio.Runner()
        self._client = AsyncClient(*args, **kwargs)

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._client, name)
        return lambda *args, **kwargs: self._runner.run(method(*args, **kwargs))

    @property
    def timeout_s(self) -> float:
        return self._client.timeout_s

    @timeout_s.setter
    def timeout_s(self, timeout_s: float) -> None:
        self._client.timeout_s = timeout_s

    def subscribe(self, *args: Any, **kwargs: Any) -> "BridgedSubscription":
        return BridgedSubscription(self._runner, self._client.subscribe(*args, **kwargs))

    def __enter__(self) -> "Bridged":
        return self

    def __exit__(self, *error: object) -> None:
        self._runner.run(self._client.close())
        self._runner.close()


class BridgedSubscription:
    """Synchronous iterator over an asynchronous one."""

    def __init__(self, runner: asyncio.Runner, updates: Any) -> None:
        self._runner = runner
        self._updates = updates

    def __iter__(self) -> Iterator[Any]:
        return self

    def __next__(self) -> Any:
        async def following() -> Any:
            return await anext(self._updates, _END)

        update = self._runner.run(following())
        if update is _END:
            raise StopIteration
        return update

    def __enter__(self) -> "BridgedSubscription":
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def close(self) -> None:
        self._updates.close()
