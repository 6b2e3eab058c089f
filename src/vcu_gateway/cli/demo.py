"""`vcu-gateway demo`: gateway and simulated vehicle together, with a live table."""

import socket
import sys
import threading
from pathlib import Path

import click

from vcu_gateway.errors import Problem, UnavailableError

_IFF_UP = 1
_PLAIN_EVERY_S = 2.0
_LIVE_HZ = 5.0


@click.command("demo")
@click.option(
    "--duration",
    "duration_s",
    type=click.FloatRange(min=0, min_open=True),
    metavar="SECONDS",
    help="Stop by itself after so long; default: Ctrl-C.",
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
    """Show gateway and simulated vehicle together, with live values.

    Uses vcan0 where there is one that is up, else python-can's virtual bus inside this
    process; the first line says which. No hardware is touched.
    """
    try:
        from vcu_gateway import demonstration, log
    except ImportError as error:
        remedy = "install the extra: pip install 'vcu-gateway[tui]'"
        raise UnavailableError(Problem(f"the live table needs {error.name}", "", remedy)) from error
    log.configure("error", "console")
    real = vcan0_is_up()
    where = "vcan0" if real else "python-can's virtual bus (no vcan0 is up)"
    demo = demonstration.Demonstration(
        "socketcan" if real else "virtual",
        "vcan0" if real else "demo",
        title=f"vcu-gateway demo on {where}, Ctrl-C ends it",
        throttle_pct=throttle_pct,
        battery_speedup=battery_speedup,
    )
    live = sys.stdout.isatty()
    done = threading.Event()
    shower = threading.Thread(
        target=demo.show_live if live else demo.show_plain,
        args=(done, 1 / _LIVE_HZ if live else _PLAIN_EVERY_S),
        name="table",
    )
    shower.start()
    try:
        demo.run(duration_s)
    finally:
        done.set()
        shower.join()
    click.echo(demo.summary())


def vcan0_is_up() -> bool:
    """True where this kernel has CAN and vcan0 is up."""
    try:
        flags = int(Path("/sys/class/net/vcan0/flags").read_text(), 16)
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).close()
    except (OSError, ValueError, AttributeError):
        return False
    return bool(flags & _IFF_UP)
