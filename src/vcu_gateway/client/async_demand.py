"""Demand owner of the asyncio client: a task drives the demand session."""

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from typing import Self, Unpack

from vcu_gateway.client.demand import (
    RELEASE_TIMEOUT_S,
    RELEASED_BEFORE_ARMING_S,
    DemandValues,
    OwnedDemand,
    request_values,
)
from vcu_gateway.client.errors import ClientError
from vcu_gateway.units import NS_PER_S


class AsyncDemandOwner(OwnedDemand):
    """Owner of one source's demand, on a connection of its own; a dead-man's handle.

    As DemandOwner; a task of the running loop repeats the last values. A coroutine that hangs
    is covered by `hold_s`; one that blocks the whole loop stops the task too, and the demand
    ends with `ttl_ms`.
    """

    def __init__(
        self, path: Path, source: str, ttl_ms: int, hold_s: float | None, timeout_s: float
    ) -> None:
        super().__init__(path, source, ttl_ms, hold_s, timeout_s)
        self._stepped = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    def set(self, **values: Unpack[DemandValues]) -> None:
        """As DemandOwner.set; it does not wait and needs no `await`."""
        made_ns = time.monotonic_ns()
        checked = request_values(values)
        if self._task is None or self._task.done():
            raise ClientError("the demand is not entered, or released")
        self._session.send_values(checked, made_ns)

    async def release(self) -> None:
        """Demand no motion, end the demand and the connection; again, it does nothing."""
        try:
            for send in (self._session.end_motion, self._session.release):
                send(time.monotonic_ns())
                await self._wait_for(lambda: self._session.settled, RELEASE_TIMEOUT_S)
        finally:
            await self._end()

    async def __aenter__(self) -> Self:
        if self._task is not None:
            raise ClientError("a demand cannot be entered again")
        self._session.open(time.monotonic_ns())
        self._task = asyncio.create_task(self._run(), name=f"demand {self._dead_man.source}")
        try:
            await self._wait_for(lambda: self._dead_man.answered, self._timeout_s)
            self._dead_man.check_first_answer(self._timeout_s)
            await asyncio.sleep(RELEASED_BEFORE_ARMING_S)
        except BaseException:
            await self._end()
            raise
        return self

    async def __aexit__(self, *exc: object) -> None:
        await self.release()

    async def _wait_for(self, condition: Callable[[], bool], timeout_s: float) -> None:
        try:
            async with asyncio.timeout(timeout_s):
                while not condition():
                    self._stepped.clear()
                    await self._stepped.wait()
        except TimeoutError:
            return

    async def _end(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait({self._task})

    async def _run(self) -> None:
        try:
            while True:
                next_step_ns = self._session.step(time.monotonic_ns())
                self._stepped.set()
                await self._wait_for_input(next_step_ns)
        finally:
            self._session.close()

    async def _wait_for_input(self, until_ns: int) -> None:
        """Wait until the gateway sends something, or until then."""
        timeout_s = max(0, until_ns - time.monotonic_ns()) / NS_PER_S
        if self._session.socket is None:
            await asyncio.sleep(timeout_s)
            return
        loop, descriptor = asyncio.get_running_loop(), self._session.socket.fileno()
        readable = asyncio.Event()
        loop.add_reader(descriptor, readable.set)
        try:
            async with asyncio.timeout(timeout_s):
                await readable.wait()
        except TimeoutError:
            return
        finally:
            loop.remove_reader(descriptor)
