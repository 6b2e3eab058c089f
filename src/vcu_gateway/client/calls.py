"""Calls: one request of the API, what its failures mean, and whether it may be sent again.

Both clients send these, each in its own way; the demand has a connection and rules of its own.
"""

from collections.abc import Iterable, Mapping
from typing import Generic, NamedTuple, TypeVar, cast

from vcu_gateway.api import results
from vcu_gateway.client import jsonrpc
from vcu_gateway.client.errors import ApiTimeoutError, DisconnectedError, GarbledError

ResultT = TypeVar("ResultT")

_LOWEST_RATE_HZ = 0.1
_STOPS = frozenset({"disarm", "estop"})
_CHANGES = _STOPS | {"arm", "reset", "drive_mode.set", "config.reload"}


class Call(NamedTuple, Generic[ResultT]):
    """One request before it has a number, and what its failures mean."""

    method: str
    params: Mapping[str, object] = {}

    @property
    def changes(self) -> bool:
        """Whether it is not read-only."""
        return self.method in _CHANGES

    def may_retry(self, error: DisconnectedError) -> bool:
        """Whether it may be sent again on a new connection.

        One that changes something is never sent twice, unless it stops the vehicle: twice is
        better than in doubt.
        """
        return error.carried_out is False or self.method in _STOPS or not self.changes

    def result(self, response: jsonrpc.Response | None, *, sent: bool) -> ResultT:
        """The response's result.

        Args:
            response: None where the connection ended first.
            sent: False where the gateway cannot have got the whole request.

        Raises:
            ApiError: the gateway's error.
            DisconnectedError: there is no response.
        """
        if response is not None:
            return cast(ResultT, response.value())
        closed = "the gateway closed the connection before it"
        if not sent:
            raise DisconnectedError(f"{closed} got {self.method}", carried_out=False)
        raise DisconnectedError(f"{closed} answered {self.method}{self._doubt}")

    def timed_out(self, timeout_s: float) -> ApiTimeoutError:
        """No response within this time."""
        return ApiTimeoutError(f"no answer to {self.method} within {timeout_s:g} s{self._doubt}")

    def garbled(self, error: GarbledError) -> GarbledError:
        """A garbled message instead of the response."""
        return GarbledError(f"{error}{self._doubt}")

    @property
    def _doubt(self) -> str:
        """End of a sentence about a missing response; empty for read-only requests."""
        return f"; it is unknown whether {self.method} was carried out" if self.changes else ""


def subscribing(messages: Iterable[str] | None, rate_hz: float) -> Call[results.Subscribed]:
    """The state `rate_hz` times a second; for a connection of its own."""
    return Call("state.subscribe", {**selection(messages), "rate_hz": rate_hz})


def update_in(message: jsonrpc.Incoming) -> results.Update | None:
    """The update that a subscription's message carries; None for any other message."""
    if isinstance(message, jsonrpc.Notification) and message.method == "state.update":
        return cast(results.Update, message.params)
    return None


def update_timeout_s(rate_hz: float, timeout_s: float) -> float:
    """Time after which an update of a subscription at this rate is overdue."""
    return timeout_s + 1 / max(rate_hz, _LOWEST_RATE_HZ)


def selection(messages: Iterable[str] | None) -> dict[str, object]:
    """Parameters that name these messages, or all of them."""
    return {} if messages is None else {"messages": list(messages)}
