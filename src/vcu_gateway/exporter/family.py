"""What a family of metrics is, and the instant that one scrape reads."""

from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from typing import Literal, NamedTuple

from vcu_gateway.api.results import ApiCounts
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.state import Snapshot
from vcu_gateway.daemon.loop import LastTick, TickLoop

PREFIX = "vcu_gateway_"
NS_PER_S = 1_000_000_000

Kind = Literal["counter", "gauge", "histogram"]
Samples = Mapping[tuple[str, ...], float]
"""Values by the values of the labels; what is not known is not in it."""


class Facts(NamedTuple):
    """What the program knows of itself.

    Attributes:
        started_ns: when it started, CLOCK_MONOTONIC; started_s: the same, seconds since 1970.
        starts: since the machine booted, this one included; None where they are not counted.
        config_digest: called at every scrape, as a reload changes it.
    """

    version: str
    python: str
    protocol_digest: str
    config_digest: Callable[[], str]
    started_ns: int
    started_s: float
    starts: int | None
    log_lines_dropped: Callable[[], int]


class Instant(NamedTuple):
    """Where one scrape reads, on a thread of its own, while others write.

    No lock is taken, so no tick waits for a scrape. Numbers and frozen values are read whole;
    `latest` is one value with all that the last tick decided. A dict or list that another
    thread writes is copied by one call into C (`dict(...)`, `tuple(...)`), which the interpreter
    does not interrupt, and the copy is read. Two families may thus differ by what happened
    between their readings; one family never contradicts itself.

    Attributes:
        latest: the last tick; None before the first.
    """

    now_ns: int
    daemon: TickLoop
    latest: LastTick | None
    snapshot: Snapshot
    api: ApiCounts
    facts: Facts

    @property
    def gateway(self) -> Gateway:
        """The core."""
        return self.daemon.gateway

    def since_s(self, then_ns: int) -> float:
        """Seconds since then, never below 0: what is read may be younger than `now_ns`."""
        return max(0, self.now_ns - then_ns) / NS_PER_S


def look(daemon: TickLoop, api: ApiCounts, facts: Facts, now_ns: int) -> Instant:
    """The instant that is now."""
    snapshot = daemon.gateway.intake.store.snapshot(now_ns)
    return Instant(now_ns, daemon, daemon.latest, snapshot, api, facts)


class Family(NamedTuple):
    """One metric with all its label sets.

    Attributes:
        name: as it is exposed; a counter's ends in _total.
        help: one sentence, with what an absent sample means.
        labels: their names, in the order of the keys that `read` gives.
        read: its samples. A histogram's key is the upper bound "le", its values cumulative.
    """

    name: str
    kind: Kind
    help: str
    labels: tuple[str, ...]
    read: Callable[[Instant], Samples]


def counter(name: str, text: str, read: Callable[[Instant], Samples], *labels: str) -> Family:
    """A count since the start of the program."""
    return Family(f"{PREFIX}{name}_total", "counter", text, labels, read)


def gauge(name: str, text: str, read: Callable[[Instant], Samples], *labels: str) -> Family:
    """A value that rises and falls."""
    return Family(PREFIX + name, "gauge", text, labels, read)


def one(value: float | None) -> Samples:
    """The sample of a family without labels; absent where the value is None."""
    return {} if value is None else {(): value}


def by(values: Mapping[str, float]) -> Samples:
    """A sample for each value of the only label; `values` may be written by another thread."""
    return {(label,): value for label, value in dict(values).items()}


def states(members: Iterable[Enum], standing: Iterable[Enum]) -> Samples:
    """1 for each member that stands, 0 for the others, by value."""
    standing = frozenset(standing)
    return {(str(member.value),): float(member in standing) for member in members}
