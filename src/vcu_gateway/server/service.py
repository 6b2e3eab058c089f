"""What the server needs of the program behind it."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

from vcu_gateway.api.errors import RequestError
from vcu_gateway.api.methods import Params
from vcu_gateway.api.results import State
from vcu_gateway.api.rights import Peer, Right

Reply = Mapping[str, Any] | RequestError
"""A result, or why there is none."""


class Caller(NamedTuple):
    """One connection of one process.

    Attributes:
        connection: number of the connection, never used twice.
    """

    connection: int
    peer: Peer
    rights: frozenset[Right]


class RequestService(Protocol):
    """Answers requests; every method is called on the API's thread and returns at once."""

    def begin(
        self, method: str, params: Params, caller: Caller, reply: Callable[[Reply], None]
    ) -> None:
        """Answer one permitted request through `reply`: once, now or later, from any thread."""

    def state(self, messages: list[str] | None) -> State:
        """What a subscription sends; Failure where a message is not known."""

    def metrics(self) -> bytes:
        """The metrics in Prometheus's text format; Failure where they are not installed."""

    def owns_demand(self, caller: Caller) -> bool:
        """True while a fresh demand of this connection counts."""

    def refused(self, method: str, caller: Caller, sentence: str) -> None:
        """A request was refused for want of a right; to be logged."""

    def closed(self, caller: Caller, reason: str) -> None:
        """The gateway ended this connection; to be logged."""

    def gone(self, caller: Caller) -> None:
        """The connection has ended, whoever ended it: its demand ends too."""
