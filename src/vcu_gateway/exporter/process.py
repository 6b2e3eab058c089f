"""Metrics of the gateway's process, named and described as prometheus_client's own."""

from collections.abc import Callable

from vcu_gateway.api import results
from vcu_gateway.exporter.family import Family, Kind, of_health, one


def _process(
    name: str, text: str, value: Callable[[results.Health], float | None], kind: Kind = "gauge"
) -> Family:
    return Family(f"process_{name}", kind, text, (), of_health(lambda health: one(value(health))))


FAMILIES: tuple[Family, ...] = (
    _process(
        "virtual_memory_bytes",
        "Virtual memory size in bytes.",
        lambda health: health["process"]["virtual_memory_bytes"],
    ),
    _process(
        "resident_memory_bytes",
        "Resident memory size in bytes.",
        lambda health: health["process"]["resident_memory_bytes"],
    ),
    _process(
        "start_time_seconds",
        "Start time of the process since unix epoch in seconds.",
        lambda health: health["start_time_s"],
    ),
    _process(
        "cpu_seconds_total",
        "Total user and system CPU time spent in seconds.",
        lambda health: health["process"]["cpu_time_s"],
        "counter",
    ),
    _process(
        "open_fds",
        "Number of open file descriptors.",
        lambda health: health["process"]["open_fds"],
    ),
    _process(
        "max_fds",
        "Maximum number of open file descriptors.",
        lambda health: health["process"]["max_fds"],
    ),
)
"""In the order of the text."""
