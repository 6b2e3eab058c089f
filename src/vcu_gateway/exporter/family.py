"""Family of metrics: name, type, help text, labels, and its samples in a reading of the API."""

from collections.abc import Callable, Iterable, Mapping
from typing import Literal, NamedTuple, TypeVar

from vcu_gateway.api import results
from vcu_gateway.exporter.reader import GatewayAnswers

LabelT = TypeVar("LabelT", bound=str)

PREFIX = "vcu_gateway_"
MS_PER_S = 1_000
US_PER_S = 1_000_000

Kind = Literal["counter", "gauge", "histogram"]
Samples = Mapping[tuple[str, ...], float]
"""Values by the values of the labels; what is not known is not in it."""


class Family(NamedTuple):
    """One metric with all its label sets.

    Attributes:
        name: as it is exposed; a counter's ends in _total.
        help: one sentence, with what an absent sample means.
        labels: their names, in the order of the keys of `read`'s samples.
        read: its samples. A histogram's key is the upper bound "le", its values cumulative.
            KeyError where the gateway is too old to report them.
    """

    name: str
    kind: Kind
    help: str
    labels: tuple[str, ...]
    read: Callable[[GatewayAnswers], Samples]

    def samples(self, reading: GatewayAnswers) -> Samples:
        """The samples; none where the gateway is too old to report them."""
        try:
            return self.read(reading)
        except KeyError:
            return {}


def counter(
    name: str, text: str, read: Callable[[GatewayAnswers], Samples], *labels: str
) -> Family:
    """A count since the start of the gateway."""
    return Family(f"{PREFIX}{name}_total", "counter", text, labels, read)


def gauge(name: str, text: str, read: Callable[[GatewayAnswers], Samples], *labels: str) -> Family:
    return Family(PREFIX + name, "gauge", text, labels, read)


def of_health(read: Callable[[results.Health], Samples]) -> Callable[[GatewayAnswers], Samples]:
    """Samples of `health`; none where the gateway does not answer."""
    return lambda reading: {} if reading.health is None else read(reading.health)


def of_state(read: Callable[[results.State], Samples]) -> Callable[[GatewayAnswers], Samples]:
    """Samples of the state; none before the first tick."""
    return lambda reading: {} if reading.state is None else read(reading.state)


def of_why(read: Callable[[results.Why], Samples]) -> Callable[[GatewayAnswers], Samples]:
    """Samples of `why`; none before the first tick."""
    return lambda reading: {} if reading.why is None else read(reading.why)


def one(value: float | None) -> Samples:
    """The sample of a family without labels; none where the value is None."""
    return {} if value is None else {(): value}


def by(values: Mapping[LabelT, float]) -> Samples:
    """One sample for each value of the only label."""
    return {(label,): value for label, value in values.items()}


def states(known: Iterable[str], standing: Iterable[str]) -> Samples:
    """1 for each word that stands, 0 for the other known ones."""
    return by(dict.fromkeys(known, 0.0) | dict.fromkeys(standing, 1.0))
