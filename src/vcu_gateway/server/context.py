"""Server context: the parts of the program that the handlers of requests use."""

from collections.abc import Callable
from typing import NamedTuple

from vcu_gateway.api import results
from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.bus.connection import BusSettings
from vcu_gateway.daemon.loop import LastTick, TickLoop
from vcu_gateway.daemon.reload import EffectiveConfig, Reloader
from vcu_gateway.server.health import RunFacts


class ServerContext(NamedTuple):
    """Parts of the running program, put together by `app`.

    Attributes:
        api_counts: counters of the API.
    """

    loop: TickLoop
    bus: BusSettings
    in_effect: EffectiveConfig
    reloader: Reloader
    facts: RunFacts
    protocol: results.Protocol
    api_counts: Callable[[], results.ApiCounts]

    def latest(self) -> LastTick:
        """Last tick; RequestError before the first."""
        latest = self.loop.latest
        if latest is None:
            raise RequestError(ErrorCode.NOT_READY, "the gateway has not ticked yet; try again")
        return latest
