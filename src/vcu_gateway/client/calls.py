"""Calls: every method of the API with its parameters, its result's type and its retry rule.

Both clients send these, each in its own way; the demand has a connection and rules of its own.
"""

from collections.abc import Iterable, Mapping
from typing import Generic, NamedTuple, TypeVar, cast

from vcu_gateway.api import results
from vcu_gateway.client import jsonrpc
from vcu_gateway.client.errors import ApiTimeoutError, DisconnectedError, GarbledError

ResultT = TypeVar("ResultT")

_LOWEST_RATE_HZ = 0.1


class Call(NamedTuple, Generic[ResultT]):
    """One request before it has a number, and what its failures mean.

    Attributes:
        changes: not read-only; it is never sent twice,
        stops: unless it stops the vehicle: twice is better than in doubt.
    """

    method: str
    params: Mapping[str, object]
    changes: bool = False
    stops: bool = False

    def may_retry(self, error: DisconnectedError) -> bool:
        """Whether it may be sent again on a new connection."""
        return error.carried_out is False or self.stops or not self.changes

    def result(self, response: jsonrpc.Response | None, *, sent: bool) -> ResultT:
        """The response's result.

        Args:
            response: None where the connection ended first.
            sent: False where the gateway cannot have got the whole request.

        Raises:
            ApiError: the gateway's error.
            DisconnectedError: there is no response.
        """
        if response is None:
            raise self._disconnected(sent=sent)
        return cast(ResultT, response.value())

    def timed_out(self, timeout_s: float) -> ApiTimeoutError:
        """No response within this time."""
        return ApiTimeoutError(f"no answer to {self.method} within {timeout_s:g} s{self._doubt}")

    def garbled(self, error: GarbledError) -> GarbledError:
        """A garbled message instead of the response."""
        return GarbledError(f"{error}{self._doubt}")

    def _disconnected(self, *, sent: bool) -> DisconnectedError:
        if not sent:
            sentence = f"the gateway closed the connection before it got {self.method}"
            return DisconnectedError(sentence, carried_out=False)
        sentence = f"the gateway closed the connection before it answered {self.method}"
        return DisconnectedError(sentence + self._doubt)

    @property
    def _doubt(self) -> str:
        """End of a sentence about a missing response; empty for read-only requests."""
        return f"; it is unknown whether {self.method} was carried out" if self.changes else ""


def state(messages: Iterable[str] | None) -> Call[results.State]:
    """Received signals and sent commands now; all messages where `messages` is None."""
    return Call("state.get", _selection(messages))


def subscribe(messages: Iterable[str] | None, rate_hz: float) -> Call[results.Subscribed]:
    """The state `rate_hz` times a second, 0.1 to 50; for a connection of its own."""
    return Call("state.subscribe", {**_selection(messages), "rate_hz": rate_hz})


def why() -> Call[results.Why]:
    """Reasons why the vehicle does or does not move."""
    return Call("why", {})


def health() -> Call[results.Health]:
    """State of the gateway itself."""
    return Call("health", {})


def events(limit: int) -> Call[results.Events]:
    """The latest events, at most `limit`."""
    return Call("events", {"limit": limit})


def config() -> Call[results.ConfigInEffect]:
    """The configuration in effect."""
    return Call("config.get", {})


def protocol() -> Call[results.Protocol]:
    """Messages and signals of the bus."""
    return Call("protocol.get", {})


def arm() -> Call[results.Granted]:
    """From standby to active."""
    return Call("arm", {}, changes=True)


def disarm() -> Call[results.Granted]:
    """From active to standby."""
    return Call("disarm", {}, changes=True, stops=True)


def reset(level: results.FaultClassName) -> Call[results.Granted]:
    """From fault to starting."""
    return Call("reset", {"level": level}, changes=True)


def set_drive_mode(mode: str, level: results.FaultClassName) -> Call[results.Granted]:
    """Another drive mode."""
    return Call("drive_mode.set", {"mode": mode, "level": level}, changes=True)


def tuning() -> Call[results.TuningNow]:
    """Drive mode, curves and slip limiter in the last tick."""
    return Call("tuning.get", {})


def estop() -> Call[results.Granted]:
    """Emergency stop: cut the power of both controllers."""
    return Call("estop", {}, changes=True, stops=True)


def reload() -> Call[results.Reloaded]:
    """Read the configuration file again."""
    return Call("config.reload", {}, changes=True)


def update_in(message: jsonrpc.Incoming) -> results.Update | None:
    """The update that a subscription's message carries; None for any other message."""
    if isinstance(message, jsonrpc.Notification) and message.method == "state.update":
        return cast(results.Update, message.params)
    return None


def update_timeout_s(rate_hz: float, timeout_s: float) -> float:
    """Time after which an update of a subscription at this rate is overdue."""
    return timeout_s + 1 / max(rate_hz, _LOWEST_RATE_HZ)


def _selection(messages: Iterable[str] | None) -> dict[str, object]:
    return {} if messages is None else {"messages": list(messages)}
