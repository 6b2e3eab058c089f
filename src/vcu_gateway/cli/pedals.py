"""`vcu-gateway pedals`: what pedals on this machine say, as a demand."""

from contextlib import closing
from pathlib import Path

import click

from vcu_gateway.cli.options import ANY_PATH, config_file_option, socket_option, stopped_by_signals
from vcu_gateway.client import Client
from vcu_gateway.pedals import configuration, program
from vcu_gateway.pedals.sources import open_source
from vcu_gateway.text import say

DEFAULT_PEDALS = Path("/etc/vcu-gateway/pedals.yaml")


@click.command("pedals")
@config_file_option(
    "Configuration of the pedals.", type=ANY_PATH, default=DEFAULT_PEDALS, show_default=True
)
@socket_option
@click.option("--show", is_flag=True, help="Draw what is read, for calibration; demand nothing.")
def pedals(config_path: Path, socket_path: Path | None, show: bool) -> None:
    """Demand what the pedals of a joystick or of converters (IIO) say.

    A program beside the gateway, which needs the right to demand. It never arms. Where the device
    goes, a read fails or two in a row are late, it releases the demand and ends with 69.
    Ctrl-C or SIGTERM ends it.
    """
    config = configuration.load(config_path)
    with stopped_by_signals() as stop, closing(open_source(config)) as source:
        if config.bench_use_only:
            say("bench use only, wheels off the ground: a second track checks nothing here")
        if show:
            program.show(config, source, _draw, stop)
            return
        with Client(socket_path) as client:
            program.run(config, source, client, stop, say)


def _draw(text: str) -> None:
    click.clear()  # on a terminal alone
    click.echo(text)
