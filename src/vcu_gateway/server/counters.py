"""Counters of the API."""

from collections import Counter
from dataclasses import dataclass, field

from vcu_gateway.api.results import ApiCounts
from vcu_gateway.server.views import result_of


@dataclass(slots=True)
class Counters:
    """Counters written by the API's thread alone: the fields of results.ApiCounts."""

    clients: int = 0
    accepted: int = 0
    turned_away: int = 0
    requests: int = 0
    errors: Counter[str] = field(default_factory=Counter)
    closed: Counter[str] = field(default_factory=Counter)
    lost_updates: int = 0
    gave_way: int = 0
    stopped_anyway: int = 0

    def report(self) -> ApiCounts:
        """Copy of the counters; from any thread."""
        return result_of(ApiCounts, self, errors=self.errors.copy(), closed=self.closed.copy())
