"""The families as Prometheus's text: the one door of prometheus_client."""

from collections.abc import Callable, Iterator

from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from vcu_gateway.api.results import ApiCounts
from vcu_gateway.daemon.loop import TickLoop
from vcu_gateway.exporter.families import FAMILIES
from vcu_gateway.exporter.family import Facts, Family, Samples, look


class Exposition:
    """The metrics of one program."""

    def __init__(
        self,
        daemon: TickLoop,
        api_counts: Callable[[], ApiCounts],
        facts: Facts,
        clock: Callable[[], int],
    ) -> None:
        self._registry = CollectorRegistry()
        self._registry.register(_State(daemon, api_counts, facts, clock))
        ProcessCollector(registry=self._registry)

    def text(self) -> bytes:
        """All that is known now; on any thread, and no other thread waits for it."""
        return generate_latest(self._registry)


class _State(Collector):
    """Reads the program's state when it is asked; keeps nothing."""

    def __init__(
        self,
        daemon: TickLoop,
        api_counts: Callable[[], ApiCounts],
        facts: Facts,
        clock: Callable[[], int],
    ) -> None:
        self._daemon = daemon
        self._api_counts = api_counts
        self._facts = facts
        self._clock = clock

    def collect(self) -> Iterator[Metric]:
        """Every family that has a sample, or none yet."""
        at = look(self._daemon, self._api_counts(), self._facts, self._clock())
        for family in FAMILIES:
            yield _metric(family, family.read(at))


def _metric(family: Family, samples: Samples) -> Metric:
    if family.kind == "histogram":
        return _histogram(family, samples)
    kind = CounterMetricFamily if family.kind == "counter" else GaugeMetricFamily
    metric = kind(family.name, family.help, labels=family.labels)
    for labels, value in samples.items():
        metric.add_metric(labels, value)
    return metric


def _histogram(family: Family, samples: Samples) -> Metric:
    """Buckets and their count; the library adds a count only where there is a sum."""
    metric = HistogramMetricFamily(family.name, family.help)
    buckets = [(bound, value) for (bound,), value in samples.items()]
    metric.add_metric([], buckets, sum_value=None)
    metric.add_sample(f"{family.name}_count", {}, buckets[-1][1])
    return metric
