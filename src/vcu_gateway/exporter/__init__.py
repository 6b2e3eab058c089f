"""Prometheus exporter: a client of the gateway's API, in a process of its own.

`reader` asks the API at each scrape; `vehicle`, `program` and `recorder` define the metrics, one
`Family` each, as functions of what it answered; `prometheus` serves them over HTTP. Only
`prometheus` imports prometheus_client, and nothing here imports it.
"""

from vcu_gateway.exporter import program, recorder, vehicle
from vcu_gateway.exporter.family import Family, GatewayAnswers, GatewayReader

__all__ = ["FAMILIES", "Family", "GatewayAnswers", "GatewayReader"]

FAMILIES: tuple[Family, ...] = (*vehicle.FAMILIES, *program.FAMILIES, *recorder.FAMILIES)
"""All families of metrics, in the order of the text."""
