"""Link to the gateway: one subscription and a few questions a second, for all browsers together.

While nobody looks it brings the samples that the plots keep, and asks nothing.
"""

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

from vcu_gateway import __version__
from vcu_gateway.client import AsyncClient, ClientError
from vcu_gateway.units import NS_PER_MS
from vcu_gateway.web import history
from vcu_gateway.web.answers import AnswerSections
from vcu_gateway.web.broadcast import Broadcast
from vcu_gateway.web.events import WebEvents

RATE_HZ = 20.0
_UNSEEN_RATE_HZ = float(history.RATE_HZ)
_BEAT_S = 0.25
_ANSWER_TIMEOUT_S = 1.0
_AGAIN_S = 0.25
_WHY_EVERY_S, _HEALTH_EVERY_S = 0.25, 1.0
_EVENTS = 100


class GatewayLink:
    """Follows the gateway and publishes what it says; a gateway that ends is found again.

    Attributes:
        answers: what it said.
        problem: sentence why there are no updates; None while they come.
        certificate: sentence about the page's own certificate; None where there is nothing to say.
    """

    def __init__(self, socket_path: Path, broadcast: Broadcast, events: WebEvents) -> None:
        self.answers = AnswerSections(broadcast, events, now_ms)
        self.problem: str | None = "the gateway has not answered yet"
        self.certificate: str | None = None
        self._events = events
        self._is_read = broadcast.is_read
        self._client = AsyncClient(socket_path, _ANSWER_TIMEOUT_S)
        self._mode: object = None
        self._mode_changed = asyncio.Event()

    async def run(self) -> None:
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._follow_again_and_again())
            tasks.create_task(self._every(_WHY_EVERY_S, self._ask_why, self._mode_changed))
            tasks.create_task(self._every(_HEALTH_EVERY_S, self._ask_health))
            tasks.create_task(self._every(_HEALTH_EVERY_S, self._ask_events))
            tasks.create_task(self._beat())

    async def _follow_again_and_again(self) -> None:
        while True:
            try:
                await self._follow_at_rates()
                sentence = "the gateway ended the connection"
            except ClientError as error:
                sentence = str(error)
            self._lose(sentence)
            await asyncio.sleep(_AGAIN_S)

    async def _follow_at_rates(self) -> None:
        self.answers.take_protocol(await self._client.protocol())
        while await self._follow(is_read=self._is_read.is_set()):
            pass

    async def _follow(self, *, is_read: bool) -> bool:
        """Follow until the first browser comes or the last one leaves; False where it ended."""
        rate_hz = RATE_HZ if is_read else _UNSEEN_RATE_HZ
        async with self._client.subscribe(rate_hz=rate_hz) as updates:
            async for update in updates:
                self._take(update.get("state"))
                if self._is_read.is_set() != is_read:
                    return True
        return False

    def _take(self, state: object) -> None:
        if not self.answers.take_state(state):
            self._lose("the gateway's states cannot be dated")
            return
        if self.problem is not None:
            self._find()
        mode = self.answers.latest and self.answers.latest.get("mode")
        if mode != self._mode:
            self._mode = mode
            self._mode_changed.set()  # the reason is another one

    def _find(self) -> None:
        self.problem = None
        self._events.tell("gateway_found", "info", protocol=self.answers.protocol_digest)
        self._publish_link()

    def _lose(self, sentence: str) -> None:
        if self.problem is None:
            self._events.tell("gateway_lost", "warning", reason=sentence)
        self.problem = sentence
        self._publish_link()

    async def _every(
        self,
        period_s: float,
        ask: Callable[[], Awaitable[None]],
        at_once: asyncio.Event | None = None,
    ) -> None:
        """Ask again and again while somebody looks, and where `at_once` is set."""
        at_once = at_once or asyncio.Event()
        while True:
            if not self._is_read.is_set():
                self.answers.forget()
                await self._is_read.wait()
            at_once.clear()
            if self.problem is None:
                # Whether the gateway is there decides the subscription alone.
                with contextlib.suppress(ClientError):
                    await ask()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(at_once.wait(), period_s)

    async def _ask_why(self) -> None:
        self.answers.take_why(await self._client.why())

    async def _ask_health(self) -> None:
        self.answers.take_health(await self._client.health())

    async def _ask_events(self) -> None:
        self.answers.take_events(await self._client.events(_EVENTS))

    async def _beat(self) -> None:
        """Four times a second: this program lives, and whether the gateway does."""
        while True:
            self.answers.send_events()
            self._publish_link()
            await asyncio.sleep(_BEAT_S)

    def _publish_link(self) -> None:
        link = {
            "t": now_ms(),
            "problem": self.problem,
            "certificate": self.certificate,
            "not_understood": self.answers.not_understood,
            "versions": {"page": __version__, "gateway": self.answers.gateway_version},
        }
        self.answers.publish("link", link)

    def tell_certificate(self, sentence: str) -> None:
        """The page's certificate is near its end: an event, and a line on the page."""
        self.certificate = sentence
        self._events.tell("certificate_ends", "warning", sentence=sentence)

    async def close(self) -> None:
        await self._client.close()


def now_ms() -> float:
    """CLOCK_MONOTONIC of this machine, the clock of the gateway's stamps."""
    return time.monotonic_ns() / NS_PER_MS
