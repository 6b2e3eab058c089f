"""Counters of the API."""

from dataclasses import dataclass, field

from vcu_gateway.api.results import ApiCounts


@dataclass(slots=True)
class Counters:
    """Counters written by the API's thread alone; see results.ApiCounts.

    Attributes:
        delayed: requests that had to wait because their connection sent too many.
    """

    clients: int = 0
    accepted: int = 0
    turned_away: int = 0
    requests: int = 0
    delayed: int = 0
    errors: dict[str, int] = field(default_factory=dict)
    closed: dict[str, int] = field(default_factory=dict)
    lost_updates: int = 0
    gave_way: int = 0
    stopped_anyway: int = 0

    def count_error(self, word: str) -> None:
        """Count an answer that is an error."""
        self.errors[word] = self.errors.get(word, 0) + 1

    def count_closed(self, reason: str) -> None:
        """Count a connection that the gateway closed."""
        self.closed[reason] = self.closed.get(reason, 0) + 1

    def report(self) -> ApiCounts:
        """Copy of the counters; from any thread."""
        return ApiCounts(
            clients=self.clients,
            accepted=self.accepted,
            turned_away=self.turned_away,
            requests=self.requests,
            errors=self.errors.copy(),
            closed=self.closed.copy(),
            lost_updates=self.lost_updates,
            gave_way=self.gave_way,
            stopped_anyway=self.stopped_anyway,
        )
