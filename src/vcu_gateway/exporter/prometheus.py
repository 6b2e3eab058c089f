"""Prometheus's text format and HTTP server, both prometheus_client's own."""

from collections.abc import Callable, Iterator
from typing import Any

from prometheus_client import CollectorRegistry, start_http_server
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    Metric,
)
from prometheus_client.registry import Collector

from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.exporter import FAMILIES
from vcu_gateway.exporter.family import Family, GatewayAnswers, Samples

_IDLE_S = 10.0
"""Longest wait for a request on a connection: each holds a thread."""


class HttpServer:
    """HTTP server on a thread of its own, until `close`; a thread for each connection.

    Attributes:
        port: the one it listens on, also where any was asked for with 0.
    """

    def __init__(self, read: Callable[[], GatewayAnswers], address: str, port: int) -> None:
        """Listen; UnavailableError, with what to do, where the port cannot be had."""
        try:
            self._server, self._thread = start_http_server(port, address, registry(read))
        except OSError as error:
            what = f"cannot listen on {address} port {port}: {error.strerror}"
            remedy = f"choose another with --listen, or look who has it: ss -ltnp 'sport = :{port}'"
            raise UnavailableError(Problem(what, remedy=remedy)) from error
        handler: Any = self._server.RequestHandlerClass
        handler.timeout = _IDLE_S
        self.port: int = self._server.server_port

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def registry(read: Callable[[], GatewayAnswers]) -> CollectorRegistry:
    found = CollectorRegistry()
    found.register(_Families(read))
    return found


class _Families(Collector):
    """All families, read at each scrape."""

    def __init__(self, read: Callable[[], GatewayAnswers]) -> None:
        self._read = read

    def describe(self) -> Iterator[Metric]:
        """Every family without samples: registering asks no gateway."""
        for family in FAMILIES:
            yield _metric(family, {})

    def collect(self) -> Iterator[Metric]:
        reading = self._read()
        for family in FAMILIES:
            yield _metric(family, family.samples(reading))


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
    if samples:
        buckets = [(bound, value) for (bound,), value in samples.items()]
        metric.add_metric([], buckets, sum_value=None)
        metric.add_sample(f"{family.name}_count", {}, buckets[-1][1])
    return metric
