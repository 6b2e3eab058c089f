"""The program that the API's methods ask."""

from collections.abc import Callable
from typing import NamedTuple

from vcu_gateway.api import results
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.bus.connection import BusSettings
from vcu_gateway.daemon.loop import LastTick, TickLoop
from vcu_gateway.daemon.reload import EffectiveConfig, Reloader
from vcu_gateway.server.health import RunFacts


class ServerContext(NamedTuple):
    """Its parts.

    Attributes:
        metrics: makes the metrics' text; None where they are not installed.
        api_counts: the API's own figures.
    """

    daemon: TickLoop
    bus: BusSettings
    in_effect: EffectiveConfig
    reloader: Reloader
    facts: RunFacts
    protocol: results.Protocol
    metrics: Callable[[], bytes] | None
    api_counts: Callable[[], results.ApiCounts]

    def latest(self) -> LastTick:
        """The last tick; Failure before the first."""
        latest = self.daemon.latest
        if latest is None:
            raise RequestError(ErrorCode.NOT_READY, "the gateway has not ticked yet; try again")
        return latest
