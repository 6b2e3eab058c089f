"""Every method as a value: its name, its parameters, its result's type, whether it changes.

The blocking and the asyncio client send these; the demand has its own connection and rules.
"""

from collections.abc import Iterable, Mapping
from typing import Generic, Literal, NamedTuple, TypeVar

from vcu_gateway.api import results
from vcu_gateway.client.errors import ApiTimeoutError, DisconnectedError

ResultT = TypeVar("ResultT")


class Call(NamedTuple, Generic[ResultT]):
    """A request that waits for a connection.

    Attributes:
        changes: it does more than tell; such a request is never sent twice,
        stops: unless it stops the vehicle: twice is better than in doubt.
    """

    method: str
    params: Mapping[str, object]
    changes: bool = False
    stops: bool = False

    def may_go_again(self, broken: DisconnectedError) -> bool:
        """Whether it may be sent on a new connection."""
        return broken.carried_out is False or self.stops or not self.changes

    @property
    def doubt(self) -> str:
        """What nobody knows where the answer is missing; empty where nothing can have changed."""
        return f"; it is unknown whether {self.method} was carried out" if self.changes else ""

    def unanswered(self, sent: bool) -> DisconnectedError:
        """The connection ended; `sent` is False where the gateway cannot have all of it."""
        if not sent:
            sentence = f"the gateway closed the connection before it got {self.method}"
            return DisconnectedError(sentence, carried_out=False)
        sentence = f"the gateway closed the connection before it answered {self.method}"
        return DisconnectedError(sentence + self.doubt)

    def late(self, timeout_s: float) -> ApiTimeoutError:
        """No answer came in this time."""
        return ApiTimeoutError(f"no answer to {self.method} within {timeout_s:g} s{self.doubt}")


def state(messages: Iterable[str] | None) -> Call[results.State]:
    """What is known and commanded now."""
    return Call("state.get", _chosen(messages))


def subscribe(messages: Iterable[str] | None, rate_hz: float) -> Call[results.Subscribed]:
    """The state again and again; for a connection of its own."""
    return Call("state.subscribe", {**_chosen(messages), "rate_hz": rate_hz})


def why() -> Call[results.Why]:
    """Why the vehicle does or does not move."""
    return Call("why", {})


def health() -> Call[results.Health]:
    """How the gateway itself fares."""
    return Call("health", {})


def events(limit: int) -> Call[results.Events]:
    """The latest events."""
    return Call("events", {"limit": limit})


def config() -> Call[results.ConfigInEffect]:
    """The configuration in effect."""
    return Call("config.get", {})


def protocol() -> Call[results.Protocol]:
    """Messages and signals."""
    return Call("protocol.get", {})


def arm() -> Call[results.Granted]:
    """From standby to active."""
    return Call("arm", {}, changes=True)


def disarm() -> Call[results.Granted]:
    """From active to standby."""
    return Call("disarm", {}, changes=True, stops=True)


def reset(level: Literal["driver", "service"]) -> Call[results.Granted]:
    """From fault to starting."""
    return Call("reset", {"level": level}, changes=True)


def estop() -> Call[results.Granted]:
    """Cut the power of both controllers."""
    return Call("estop", {}, changes=True, stops=True)


def reload() -> Call[results.Reloaded]:
    """Read the configuration file again."""
    return Call("config.reload", {}, changes=True)


def _chosen(messages: Iterable[str] | None) -> dict[str, object]:
    return {} if messages is None else {"messages": list(messages)}
