"""`vcu-gateway exporter`: metrics of the running gateway for Prometheus."""

from pathlib import Path

import click

from vcu_gateway.cli.options import ListenAddress, listen_option, socket_option, stopped_by_signals
from vcu_gateway.client import Client
from vcu_gateway.errors import extra_needed
from vcu_gateway.exporter import GatewayReader
from vcu_gateway.text import say


@click.command("exporter")
@socket_option
@listen_option("127.0.0.1:9464", "Where Prometheus reads; an IPv6 address stands in brackets.")
def exporter(socket_path: Path | None, listen: ListenAddress) -> None:
    """Serve the metrics of the running gateway to Prometheus, over HTTP.

    A program beside the gateway: it asks the API at each scrape, and needs no more than to open
    the gateway's socket; of the recorder it reads the state. A gateway that does not answer is
    the metric vcu_gateway_up 0.
    Whoever reaches the port can read the metrics. Ctrl-C or SIGTERM ends it.
    """
    with extra_needed("the exporter needs", "metrics", "prometheus_client"):
        from vcu_gateway.exporter import prometheus
    with stopped_by_signals() as stop, Client(socket_path) as client:
        reader = GatewayReader(client, say)
        server = prometheus.HttpServer(reader.read, listen.address, listen.port)
        host = f"[{listen.address}]" if ":" in listen.address else listen.address
        say(f"metrics of {client.socket_path} at http://{host}:{server.port}/metrics")
        stop.wait()
        server.close()
