"""What the gateway answered, as sections for the browsers; none of it needs to be as it should.

What is not understood is named, with the versions that meet, and costs what it concerns alone.
"""

from collections.abc import Callable
from itertools import islice
from typing import Any

from vcu_gateway import __version__
from vcu_gateway.api.results import Events, Health, Protocol, State, Why
from vcu_gateway.units import NS_PER_MS
from vcu_gateway.web.broadcast import Broadcast
from vcu_gateway.web.events import WebEvents
from vcu_gateway.web.history import History
from vcu_gateway.web.shape import misfits
from vcu_gateway.web.state_row import SignalOrder, definition, is_number, signal_order, state_row

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
        return self._protocol.get("digest") if isinstance(self._protocol, dict) else None

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
        messages = state.get("messages")
        names = list(messages) if isinstance(messages, dict) else []
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
        versions = health.get("versions") if isinstance(health, dict) else None
        version = versions.get("vcu_gateway") if isinstance(versions, dict) else None
        self.gateway_version = version if isinstance(version, str) else None
        self._send("health", health)

    def take_events(self, events: Any) -> None:
        """The latest events, without the ages that make them differ each time."""
        self._judge("events", events, Events)
        entries = events.get("events") if isinstance(events, dict) else None
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
        self._note(name, list(islice(dict.fromkeys(misfits(value, kind, name)), _MOST_NAMED)))

    def _note(self, name: str, found: list[str]) -> None:
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
