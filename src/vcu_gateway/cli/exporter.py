"""`vcu-gateway exporter`: metrics of the running gateway for Prometheus."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

import click

from vcu_gateway.cli.listen_address import ListenAddress, listen_option
from vcu_gateway.cli.options import socket_option
from vcu_gateway.cli.signals import stopped_by_signals
from vcu_gateway.client import Client
from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.exporter import GatewayReader


@click.command("exporter")
@socket_option
@listen_option("127.0.0.1:9464", "Where Prometheus reads; an IPv6 address stands in brackets.")
def command(socket_path: Path | None, listen: ListenAddress) -> None:
    """Serve the metrics of the running gateway to Prometheus, over HTTP.

    A program beside the gateway: it asks the API at each scrape, and needs no more than to open
    the gateway's socket; of the recorder it reads the state. A gateway that does not answer is
    the metric vcu_gateway_up 0.
    Whoever reaches the port can read the metrics. Ctrl-C or SIGTERM ends it.
    """
    with _prometheus_client_needed():
        from vcu_gateway.exporter import prometheus
    with stopped_by_signals() as stop, Client(socket_path) as client:
        reader = GatewayReader(client, _say)
        server = prometheus.HttpServer(reader.read, listen.address, listen.port)
        host = f"[{listen.address}]" if ":" in listen.address else listen.address
        _say(f"metrics of {client.socket_path} at http://{host}:{server.port}/metrics")
        stop.wait()
        server.close()


def _say(sentence: str) -> None:
    with contextlib.suppress(OSError):  # nobody reads stderr any more
        click.echo(sentence, err=True)


@contextlib.contextmanager
def _prometheus_client_needed() -> Iterator[None]:
    """UnavailableError, with what to do, where prometheus_client is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "prometheus_client":
            raise
        remedy = "install the extra: pip install 'vcu-gateway[metrics]'"
        what = "the exporter needs prometheus_client"
        raise UnavailableError(Problem(what, remedy=remedy)) from error
