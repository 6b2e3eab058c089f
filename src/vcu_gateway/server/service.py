"""Interface between the server and the program behind it."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

from vcu_gateway.api.errors import RequestError
from vcu_gateway.api.methods import Params
from vcu_gateway.api.results import State
from vcu_gateway.api.rights import Peer, Right

Reply = Mapping[str, Any] | RequestError
"""A result, or the error that is answered instead."""


class Caller(NamedTuple):
    """Peer of one connection, with its rights.

    Attributes:
        connection: number of the connection, never used twice.
    """

    connection: int
    peer: Peer
    rights: frozenset[Right]


class RequestService(Protocol):
    """Request handlers; every method is called on the API's thread and returns at once."""

    def handle(
        self, method: str, params: Params, caller: Caller, reply: Callable[[Reply], None]
    ) -> None:
        """Handle a permitted request and call `reply` once, now or later, from any thread."""

    def state(self, messages: list[str] | None) -> State:
        """State for an update of a subscription; RequestError where a message is not known."""

    def owns_demand(self, caller: Caller) -> bool:
        """True while a fresh demand of this connection counts."""

    def log_refused(self, method: str, caller: Caller, sentence: str) -> None:
        """Log a request that was refused for want of a right."""

    def log_closed(self, caller: Caller, reason: str) -> None:
        """Log a connection that the gateway closed."""

    def end_demands(self, caller: Caller) -> None:
        """End the demands of a connection that has ended, whoever ended it."""
