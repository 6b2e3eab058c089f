"""The demand of one source, kept by a task."""

import asyncio
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self, Unpack

from vcu_gateway.api import results
from vcu_gateway.client.demand import DemandRequest, request_values
from vcu_gateway.client.demand_session import DemandSession
from vcu_gateway.client.errors import ApiError, ApiTimeoutError, ClientError
from vcu_gateway.client.keeping import RELEASED_S, DeadMan
from vcu_gateway.units import NS_PER_S

_FAREWELL_S = 0.2


class AsyncDemandOwner:
    """Asks for throttle and brake in one source's name, on a connection of its own.

    As DemandOwner, with its dead-man's handle; a task of the running loop repeats the last
    values. A coroutine that hangs is covered by `hold_s`; one that blocks the whole loop stops
    the task too, and the demand ends with `ttl_ms`.
    """

    def __init__(
        self, path: Path, source: str, ttl_ms: int, hold_s: float | None, timeout_s: float
    ) -> None:
        self._timeout_s = timeout_s
        self._keeping = DeadMan(source, ttl_ms, hold_s)
        self._link = DemandSession(path, self._keeping, timeout_s)
        self._stepped = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    def set(self, **asked: Unpack[DemandRequest]) -> None:
        """As DemandOwner.set; it does not wait and needs no `await`."""
        made_ns = time.monotonic_ns()
        body = request_values(asked)
        if self._task is None or self._task.done():
            raise ClientError("the demand is not entered, or released")
        self._link.ask(body, made_ns)

    @property
    def connected(self) -> bool:
        """Whether a `set` reaches the gateway now."""
        return self._link.connected

    @property
    def refusal(self) -> ApiError | None:
        """The latest refusal, until it was raised and a later demand granted."""
        return self._keeping.refusal

    @property
    def last_answer(self) -> results.Granted | None:
        """What the gateway granted last, with its mode then; None before the first."""
        return self._keeping.last_answer

    async def release(self) -> None:
        """Ask for no motion, end the demand and the connection; again, it does nothing."""
        try:
            for last_word in (self._link.still, self._link.release):
                last_word(time.monotonic_ns())
                await self._wait(lambda: self._link.settled, _FAREWELL_S)
        finally:
            await self._end()

    async def __aenter__(self) -> Self:
        if self._task is not None:
            raise ClientError("a demand cannot be entered again")
        self._link.open(time.monotonic_ns())
        self._task = asyncio.create_task(self._keep(), name=f"demand {self._keeping.source}")
        try:
            await self._await_first_answer()
            await asyncio.sleep(RELEASED_S)
        except BaseException:
            await self._end()
            raise
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.release()

    async def _await_first_answer(self) -> None:
        heard = await self._wait(lambda: bool(self.last_answer or self.refusal), self._timeout_s)
        if self.refusal is not None:
            raise self.refusal
        if not heard:
            sentence = f"the gateway took no demand within {self._timeout_s:g} s"
            raise ApiTimeoutError(sentence)

    async def _wait(self, done: Callable[[], bool], timeout_s: float) -> bool:
        try:
            async with asyncio.timeout(timeout_s):
                while not done():
                    self._stepped.clear()
                    await self._stepped.wait()
        except TimeoutError:
            return False
        return True

    async def _end(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait({self._task})

    async def _keep(self) -> None:
        try:
            while True:
                again_ns = self._link.step(time.monotonic_ns())
                self._stepped.set()
                await self._pause(again_ns)
        finally:
            self._link.close()

    async def _pause(self, again_ns: int) -> None:
        """Until the gateway says something, or until then."""
        pause_s = max(0, again_ns - time.monotonic_ns()) / NS_PER_S
        if self._link.socket is None:
            await asyncio.sleep(pause_s)
            return
        loop, descriptor = asyncio.get_running_loop(), self._link.socket.fileno()
        readable = asyncio.Event()
        loop.add_reader(descriptor, readable.set)
        try:
            async with asyncio.timeout(pause_s):
                await readable.wait()
        except TimeoutError:
            return
        finally:
            loop.remove_reader(descriptor)
