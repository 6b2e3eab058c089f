"""`vcu-gateway demo`: gateway and simulated vehicle together, shown live."""

import contextlib
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType

import click

from vcu_gateway.cli.watch import extra_needed
from vcu_gateway.demo.process import DemoOptions, DemoProcess

_IFF_UP = 1
_PLAIN_EVERY_S = 2.0
_TITLE = "vcu-gateway demo"


@click.command("demo")
@click.option(
    "--duration",
    "duration_s",
    type=click.FloatRange(min=0, min_open=True),
    metavar="SECONDS",
    help="Stop by itself after so long; default: q or Ctrl-C.",
)
@click.option(
    "--throttle",
    "throttle_pct",
    type=click.FloatRange(0, 100),
    default=30.0,
    show_default=True,
    help="Static demand for both controllers, %.",
)
@click.option(
    "--battery-speedup",
    type=click.FloatRange(0, 10_000),
    default=20.0,
    show_default=True,
    help="Charge flows so many times as fast, to see it drain.",
)
def command(duration_s: float | None, throttle_pct: float, battery_speedup: float) -> None:
    """Show gateway and simulated vehicle together, live, as `watch` shows a real one.

    Uses vcan0 where there is one that is up, else python-can's virtual bus inside a process of
    its own; the first line says which. No hardware is touched. Without a terminal the picture
    is printed every 2 s.
    """
    with extra_needed():
        from vcu_gateway.watch import terminal
        from vcu_gateway.watch.plain_text import plain
        from vcu_gateway.watch.poller import GatewaySource
        from vcu_gateway.watch.terminal import watch
    real = vcan0_is_up()
    interface, channel = ("socketcan", "vcan0") if real else ("virtual", "in-process")
    wanted = DemoOptions(interface, channel, throttle_pct, battery_speedup, duration_s)
    with DemoProcess(wanted) as child, GatewaySource(child.socket_path) as source:
        if terminal.is_full():
            watch(source, _TITLE, child.has_ended)
        else:
            _print(lambda: plain(_TITLE, source.latest()), child)
    click.echo(child.summary)


def _print(picture: Callable[[], str], child: DemoProcess) -> None:
    """The picture now and then, for a pipe or a file."""
    with stopped_by_signals() as stop:
        while not stop.wait(_PLAIN_EVERY_S) and not child.has_ended():
            click.echo(picture())


def vcan0_is_up() -> bool:
    """True where this kernel has CAN and vcan0 is up."""
    try:
        flags = int(Path("/sys/class/net/vcan0/flags").read_text(), 16)
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (OSError, ValueError, AttributeError):
        return False
    return bool(flags & _IFF_UP)


@contextlib.contextmanager
def stopped_by_signals() -> Iterator[threading.Event]:
    """An event that SIGINT and SIGTERM set; the old handlers come back afterwards."""
    stop = threading.Event()

    def on_signal(number: int, frame: FrameType | None) -> None:
        del number, frame
        stop.set()

    numbers = (signal.SIGINT, signal.SIGTERM)
    before = {number: signal.signal(number, on_signal) for number in numbers}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
