"""Call that many ask for at once, and that is made once for all who wait."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Generic, TypeVar

ResultT = TypeVar("ResultT")


class MergedCall(Generic[ResultT]):
    """One call at a time; whoever asks while one runs shares the next, which begins after that.

    So each has what began after he asked: a stop that was carried out before is none for him.
    """

    def __init__(self, call: Callable[[], Awaitable[ResultT]]) -> None:
        self._call = call
        self._running: asyncio.Task[ResultT] | None = None
        self._next: asyncio.Task[ResultT] | None = None

    async def __call__(self) -> ResultT:
        """Result of a call that begins from now on."""
        if self._next is None:
            self._next = asyncio.create_task(self._after(self._running))
        return await asyncio.shield(self._next)  # who leaves ends it for nobody else

    async def _after(self, before: "asyncio.Task[ResultT] | None") -> ResultT:
        if before is not None:
            await asyncio.wait([before])
        self._running, self._next = self._next, None
        return await self._call()
