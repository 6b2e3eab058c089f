"""Prometheus metrics, read from the program's state at the moment of the scrape.

Nothing is done for them per frame or per tick. `bus`, `vehicle` and `program` say what there
is, one entry a family; `prometheus` alone knows prometheus_client.
"""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from vcu_gateway.api.results import ApiCounts
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.exporter.families import FAMILIES
from vcu_gateway.exporter.family import Facts, Family

if TYPE_CHECKING:
    from vcu_gateway.exporter.prometheus import Exposition

__all__ = ["CONTENT_TYPE", "FAMILIES", "Facts", "Family", "exposition"]

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
"""The HTTP content type of `Exposition.text`."""


def exposition(
    daemon: TickLoop,
    api_counts: Callable[[], ApiCounts],
    facts: Facts,
    clock: Callable[[], int] = time.monotonic_ns,
) -> "Exposition":
    """The metrics of this program; `api_counts` and what facts calls are called in `text`.

    Raises UnavailableError, with what to do, where prometheus_client is not installed.
    """
    try:
        from vcu_gateway.exporter.prometheus import Exposition
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "prometheus_client":
            raise
        remedy = "install the extra: pip install 'vcu-gateway[metrics]'"
        raise UnavailableError(Problem("metrics need prometheus_client", "", remedy)) from error
    return Exposition(daemon, api_counts, facts, clock)
