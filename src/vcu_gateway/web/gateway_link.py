"""Link to the gateway: one subscription and a few questions a second, for all browsers together.

While nobody looks it brings the samples that the plots keep, and asks nothing.

What the gateway answered, as sections for the browsers; none of it needs to be as it should.

What is not understood is named, with the versions that meet, and costs what it concerns alone.
"""

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable, Iterable
from pathlib import Path
from typing import Any

from vcu_gateway import __version__
from vcu_gateway.api.results import Events, Health, Protocol, State, Why
from vcu_gateway.client import AsyncClient, ClientError
from vcu_gateway.units import NS_PER_MS
from vcu_gateway.web import history
from vcu_gateway.web.history import History
from vcu_gateway.web.state_row import (
    SignalOrder,
    definition,
    is_number,
    misfits,
    object_at,
    part_of,
    signal_order,
    state_row,
)
from vcu_gateway.web.stream import Broadcast
from vcu_gateway.web.users import WebEvents

_MOST_NAMED = 10
_MOST_TOLD = 100
_JUDGE_STATE_EVERY_MS = 1000.0
_WHY_EVERY_MS = 1000.0
_COMES_MS = 150.0
_NOT_AS_IT_SHOULD_BE = (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError)


class AnswerSections:
    """Takes every answer, publishes it, and keeps what others ask for.

    Attributes:
        latest: state that it sent last; None before the first.
        not_understood: phrase for each part that is not as this version knows it.
        gateway_version: None until it is known.
    """

    def __init__(
        self, broadcast: Broadcast, events: WebEvents, now_ms: Callable[[], float]
    ) -> None:
        self.latest: State | None = None
        self.gateway_version: str | None = None
        self.history = History()
        self._broadcast = broadcast
        self._events = events
        self._now_ms = now_ms
        self._protocol: Any = None
        self._order: SignalOrder = {}
        self._misfits: dict[str, list[str]] = {}
        self._told: set[str] = set()
        self._state_judged_ms = self._why_told_ms = float("-inf")
        self._known_why = ""
        self._dated: list[object] = []
        self._are_events_new = False

    @property
    def protocol_digest(self) -> object:
        return part_of(self._protocol, "digest")

    @property
    def not_understood(self) -> list[str]:
        return [one for found in self._misfits.values() for one in found]

    def take_protocol(self, protocol: Any) -> None:
        """The messages, which the next state brings to the browsers."""
        self._protocol, self._order = protocol, {}
        self._judge("protocol", protocol, Protocol)

    def take_state(self, state: Any) -> bool:
        """One state; False where it has no instant, and is not shown."""
        now_ms = self._now_ms()
        is_dated = isinstance(state, dict) and is_number(state.get("monotonic_ns"))
        if now_ms - self._state_judged_ms >= _JUDGE_STATE_EVERY_MS or not is_dated:
            self._state_judged_ms = now_ms
            self._judge("state", state, State)
        if not is_dated:
            return False
        self.latest = state
        self._take("state", lambda: self._define(state))
        self._take("state", lambda: self.history.add(state))
        self._take("state", lambda: self._send_state(state, now_ms))
        return True

    def _define(self, state: Any) -> None:
        """Tell the names where the state has other messages than before."""
        names = list(object_at(state, "messages"))
        if not self._order or names != list(self._order):
            told = definition(self._protocol, names)
            self._order = signal_order(told, names)
            self._broadcast.publish("definition", told)

    def _send_state(self, state: Any, now_ms: float) -> None:
        self._broadcast.publish("state", state_row(state, self._order, now_ms))

    def take_why(self, why: Any) -> None:
        """The explanation, where it is another one, and once a second."""
        self._judge("why", why, Why)
        known, now_ms = _without_times(why), self._now_ms()
        if known != self._known_why or now_ms - self._why_told_ms >= _WHY_EVERY_MS:
            self._known_why, self._why_told_ms = known, now_ms
            self._send("why", why)

    def forget(self) -> None:
        """Drop what is asked for only while somebody looks: it would be old for who comes next."""
        self._known_why = ""
        self._broadcast.forget("why", "health")

    def take_health(self, health: Any) -> None:
        """State of the gateway itself, and its version."""
        self._judge("health", health, Health)
        version = object_at(health, "versions").get("vcu_gateway")
        self.gateway_version = version if isinstance(version, str) else None
        self._send("health", health)

    def take_events(self, events: Any) -> None:
        """The latest events, without the ages that make them differ each time."""
        self._judge("events", events, Events)
        entries = part_of(events, "events")
        dated = [_dated(one) for one in entries] if isinstance(entries, list) else []
        if dated != self._dated:
            self._dated = dated
            self.note_event()

    def note_event(self) -> None:
        """There is a new one; all go with the next beat, however many come until then."""
        self._are_events_new = True

    def send_events(self) -> None:
        """The events of gateway and page, where there are new ones."""
        if self._are_events_new:
            self._are_events_new = False
            self.publish("events", {"gateway": self._dated, "page": self._events.latest()})

    def _send(self, name: str, value: Any) -> None:
        if isinstance(value, dict):
            self._take(name, lambda: self.publish(name, {**value, "t": self._now_ms()}))

    def publish(self, name: str, value: object) -> None:
        """With the next state where they come, which is at most 50 ms: a write less for each."""
        latest = self.latest
        comes = latest and self._now_ms() - latest["monotonic_ns"] / NS_PER_MS < _COMES_MS
        self._broadcast.publish(name, value, wake=not comes)

    def _take(self, name: str, step: Callable[[], None]) -> None:
        """A step that an answer can make fail: what follows it goes on."""
        try:
            step()
        except _NOT_AS_IT_SHOULD_BE as error:
            self._note(name, [*self._misfits.get(name, ()), f"{name}: {error!r}"])

    def _judge(self, name: str, value: object, kind: Any) -> None:
        self._note(name, misfits(value, kind, name))

    def _note(self, name: str, found: Iterable[str]) -> None:
        """Keep what is not understood of an answer, and tell what was not told before."""
        self._misfits[name] = list(dict.fromkeys(found))[:_MOST_NAMED]
        new = [one for one in self._misfits[name] if one not in self._told]
        if new and len(self._told) < _MOST_TOLD:
            self._told.update(new)
            versions = {"page": __version__, "gateway": self.gateway_version}
            self._events.tell("not_understood", "warning", parts=new, **versions)


def _without_times(why: Any) -> str:
    """The explanation without ages, to compare; whole where it is not as it should be."""
    try:
        causes = [
            (one["cause"], one["subject"], one["detail"], one["effect"], one["stands"])
            for one in (*why["blocks"], *why["limits"], *why["alarms"])
        ]
        latch = why["latch"] and why["latch"]["reason"]
        return repr((why["sentence"], why["mode"], latch, causes, why["waits"], why["next_step"]))
    except _NOT_AS_IT_SHOULD_BE:
        return repr(why)


def _dated(event: Any) -> object:
    if not isinstance(event, dict):
        return event
    return {key: value for key, value in event.items() if not key.endswith("_ms")}


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
        client, answers = self._client, self.answers
        async with asyncio.TaskGroup() as tasks:
            tasks.create_task(self._follow_again_and_again())
            tasks.create_task(
                self._every(_WHY_EVERY_S, client.why, answers.take_why, self._mode_changed)
            )
            tasks.create_task(self._every(_HEALTH_EVERY_S, client.health, answers.take_health))
            tasks.create_task(
                self._every(_HEALTH_EVERY_S, lambda: client.events(_EVENTS), answers.take_events)
            )
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
        ask: Callable[[], Awaitable[Any]],
        take: Callable[[Any], None],
        at_once: asyncio.Event | None = None,
    ) -> None:
        """Ask each period while somebody looks, and where `at_once` is set; take the answers."""
        at_once = at_once or asyncio.Event()
        while True:
            if not self._is_read.is_set():
                self.answers.forget()
                await self._is_read.wait()
            at_once.clear()
            if self.problem is None:
                # Whether the gateway is there decides the subscription alone.
                with contextlib.suppress(ClientError):
                    take(await ask())
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(at_once.wait(), period_s)

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
