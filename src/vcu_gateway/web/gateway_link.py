"""Link to the gateway: one subscription and a few questions a second, for all browsers together."""

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

from vcu_gateway.api.results import Protocol, State, Why
from vcu_gateway.client import AsyncClient, ClientError
from vcu_gateway.units import NS_PER_MS
from vcu_gateway.web.broadcast import Broadcast
from vcu_gateway.web.events import WebEvents
from vcu_gateway.web.history import History
from vcu_gateway.web.power_cut import PowerCutBits, is_cut, power_cut_bits
from vcu_gateway.web.state_row import definition, state_row

RATE_HZ = 20.0
BEAT_S = 0.25
_ANSWER_TIMEOUT_S = 1.0
_AGAIN_S = 0.25
_WHY_EVERY_S, _HEALTH_EVERY_S = 0.25, 1.0
_EVENTS = 100
_COMES_MS = 150.0


class GatewayLink:
    """Follows the gateway and publishes what it says; a gateway that ends is found again.

    Attributes:
        protocol: of the gateway that answered last; None before the first.
        latest: state that it sent last; old once the link is down.
        problem: sentence why there are no updates; None while they come.
    """

    def __init__(self, socket_path: Path, broadcast: Broadcast, events: WebEvents) -> None:
        self.protocol: Protocol | None = None
        self.latest: State | None = None
        self.problem: str | None = "the gateway has not answered yet"
        self.history = History()
        self._broadcast = broadcast
        self._events = events
        self._client = AsyncClient(socket_path, _ANSWER_TIMEOUT_S)
        self._bits: PowerCutBits = {}
        self._updated = asyncio.Event()
        self._mode_changed = asyncio.Event()
        self._known_why: object = None
        self._why_told_s = 0.0
        self._dated: list[dict[str, object]] = []
        self._are_events_new = False

    async def run(self) -> None:
        """Follow until cancelled."""
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._follow_again_and_again())
            tasks.create_task(self._every(_WHY_EVERY_S, self._ask_why, self._mode_changed))
            tasks.create_task(self._every(_HEALTH_EVERY_S, self._ask_health))
            tasks.create_task(self._every(_HEALTH_EVERY_S, self._ask_events))
            tasks.create_task(self._beat())

    async def _follow_again_and_again(self) -> None:
        while True:
            try:
                await self._follow()
                sentence = "the gateway ended the connection"
            except ClientError as error:
                sentence = str(error)
            except (KeyError, TypeError, ValueError, AttributeError) as error:
                sentence = f"the gateway sent what this page does not know: {error!r}"
            self._lose(sentence)
            await asyncio.sleep(_AGAIN_S)

    async def _follow(self) -> None:
        protocol = await self._client.protocol()
        defined = False
        async with self._client.subscribe(rate_hz=RATE_HZ) as updates:
            async for update in updates:
                if not defined:
                    self._define(protocol, update["state"])
                    defined = True
                self._take(update["state"])

    def _define(self, protocol: Protocol, state: State) -> None:
        self.protocol, self._bits = protocol, power_cut_bits(protocol)
        self._broadcast.publish("definition", definition(protocol, list(state["messages"])))
        self._events.tell("gateway_found", "info", protocol=protocol["digest"])
        self.problem = None
        self._publish_link()

    def _take(self, state: State) -> None:
        if self.latest is not None and self.latest["mode"] != state["mode"]:
            self._mode_changed.set()  # the reason is another one
        self.latest = state
        self.history.add(state)
        self._broadcast.publish("state", state_row(state, now_ms()))
        updated, self._updated = self._updated, asyncio.Event()
        updated.set()

    def _lose(self, sentence: str) -> None:
        if self.problem is None:
            self._events.tell("gateway_lost", "warning", reason=sentence)
        self.problem = sentence
        self._publish_link()

    async def until_cut(self, after_ns: int, timeout_s: float) -> bool:
        """Whether a state younger than this is in fault and sent POWER_CUT to all, in time."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(timeout_s):
                while not self._is_cut_after(after_ns):
                    await self._updated.wait()
        return self._is_cut_after(after_ns)

    def _is_cut_after(self, after_ns: int) -> bool:
        latest = self.latest
        return (
            latest is not None and latest["monotonic_ns"] > after_ns and is_cut(latest, self._bits)
        )

    async def _every(
        self,
        period_s: float,
        ask: Callable[[], Awaitable[None]],
        at_once: asyncio.Event | None = None,
    ) -> None:
        """Ask again and again, and where `at_once` is set."""
        at_once = at_once or asyncio.Event()
        while True:
            at_once.clear()
            if self.problem is None:
                # Whether the gateway is there decides the subscription alone.
                with contextlib.suppress(ClientError):
                    await ask()
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(at_once.wait(), period_s)

    async def _ask_why(self) -> None:
        why = await self._client.why()
        known, now_s = _without_times(why), time.monotonic()
        if known != self._known_why or now_s - self._why_told_s >= 1.0:
            self._known_why, self._why_told_s = known, now_s
            self._publish("why", {**why, "t": now_ms()})

    async def _ask_health(self) -> None:
        self._publish("health", {**await self._client.health(), "t": now_ms()})

    async def _ask_events(self) -> None:
        events = await self._client.events(_EVENTS)
        dated = [
            {key: value for key, value in one.items() if not key.endswith("_ms")}
            for one in events["events"]
        ]
        if dated != self._dated:
            self._dated = dated
            self.note_event()

    def note_event(self) -> None:
        """There is a new one; all go with the next beat, however many come until then."""
        self._are_events_new = True

    async def _beat(self) -> None:
        """Four times a second: this program lives, and whether the gateway does."""
        while True:
            if self._are_events_new:
                self._are_events_new = False
                self._publish("events", {"gateway": self._dated, "page": self._events.latest()})
            self._publish_link()
            await asyncio.sleep(BEAT_S)

    def _publish_link(self) -> None:
        self._publish("link", {"t": now_ms(), "problem": self.problem})

    def _publish(self, name: str, value: object) -> None:
        """With the next state where they come, which is at most 50 ms: a write less for each."""
        latest = self.latest
        comes = latest is not None and now_ms() - latest["monotonic_ns"] / NS_PER_MS < _COMES_MS
        self._broadcast.publish(name, value, wake=not comes)

    async def close(self) -> None:
        """Close the connection of the questions."""
        await self._client.close()


def now_ms() -> float:
    """CLOCK_MONOTONIC of this machine, the clock of the gateway's stamps."""
    return time.monotonic_ns() / NS_PER_MS


def _without_times(why: Why) -> str:
    """The explanation without ages, to compare."""
    causes = [
        (one["cause"], one["subject"], one["detail"], one["effect"], one["stands"])
        for one in (*why["blocks"], *why["limits"], *why["alarms"])
    ]
    latch = why["latch"] and why["latch"]["reason"]
    return repr((why["sentence"], why["mode"], latch, causes, why["waits"], why["next_step"]))
