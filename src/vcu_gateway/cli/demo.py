"""`vcu-gateway demo`: gateway and simulated vehicle together, shown live."""

import contextlib
import os
import shlex
import signal
import threading
import webbrowser
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

import click

from vcu_gateway.bus.interface import Interfaces, can_socket_error
from vcu_gateway.cli.extras import tui_needed
from vcu_gateway.cli.signals import stopped_by_signals
from vcu_gateway.cli.web import web_libraries_needed
from vcu_gateway.demo.process import DemoOptions, DemoProcess
from vcu_gateway.demo.recorder import DemoRecorder

_PLAIN_EVERY_S = 2.0
_LOOK_EVERY_S = 0.2
_PAGE = ("127.0.0.1", 9465)
_TITLE = "vcu-gateway demo"
_WHAT_IF = "limits.throttle_slew_pct_per_s=10"


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
    help="Factor of the battery's charge and discharge, to see it drain.",
)
@click.option(
    "--record",
    "folder",
    metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="Record the drive into DIR; the last lines say what can be done with it.",
)
@click.option("--web", "in_browser", is_flag=True, help="Show it in a browser, not here.")
def command(
    duration_s: float | None,
    throttle_pct: float,
    battery_speedup: float,
    folder: Path | None,
    in_browser: bool,
) -> None:
    """Show gateway and simulated vehicle together, live, as `watch` shows a real one.

    Uses vcan0 where there is one that is up, else python-can's virtual bus inside a process of
    its own; the first line says which. No hardware is touched. Without a terminal the same
    is printed as text every 2 s. With --web it is shown as `vcu-gateway web` shows a real one.
    """
    real = _vcan0_is_up()
    interface, channel = ("socketcan", "vcan0") if real else ("virtual", "in-process")
    wanted = DemoOptions(interface, channel, throttle_pct, battery_speedup, duration_s)
    with _recorder(folder) as recorder:
        if recorder is not None:
            wanted = wanted._replace(recorder_socket=str(recorder.socket_path))
        summary = _in_browser(wanted, folder) if in_browser else _in_terminal(wanted)
    click.echo(summary)
    if recorder is not None and recorder.drive is not None:
        _echo_next(recorder.folder, recorder.drive)


def _in_terminal(wanted: DemoOptions) -> str:
    """Show it here; the summary."""
    with tui_needed():
        from vcu_gateway.watch import terminal
        from vcu_gateway.watch.plain_text import plain
        from vcu_gateway.watch.poller import GatewaySource
    with DemoProcess(wanted) as child, GatewaySource(child.socket_path) as source:
        if terminal.is_full():
            terminal.watch(source, _TITLE, child.has_ended)
        else:
            _print(lambda: plain(_TITLE, source.latest()), child)
    return child.summary


def _in_browser(wanted: DemoOptions, recordings: Path | None) -> str:
    """Serve the page until Ctrl-C or the end; the summary."""
    with web_libraries_needed():
        from vcu_gateway.web import application, serve
        from vcu_gateway.web.events import WebEvents
        from vcu_gateway.web.roles import UserRole
        from vcu_gateway.web.settings import WebSettings
    with DemoProcess(wanted) as child:
        settings = WebSettings(
            *_PAGE, child.socket_path, local_role=UserRole.SERVICE, recordings=recordings
        )
        app = application.build(settings, WebEvents(lambda _: None))
        stopped = threading.Event()
        threading.Thread(target=_stop_with, args=(child, stopped), daemon=True).start()
        try:
            serve.run(settings, app, lambda address: _show_page(wanted, address))
        finally:
            stopped.set()
    return child.summary


def _stop_with(child: DemoProcess, stopped: threading.Event) -> None:
    """End the page's server as Ctrl-C does, if the child ends before it."""
    while not stopped.wait(_LOOK_EVERY_S):
        if child.has_ended():
            signal.raise_signal(signal.SIGINT)
            return


def _show_page(wanted: DemoOptions, address: str) -> None:
    """Say where it is, and open it in this desktop's browser, where there is one."""
    click.echo(f"{_TITLE} on {wanted.channel}: {address} (Ctrl-C ends it)")
    if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(address)


def _recorder(folder: Path | None) -> AbstractContextManager[DemoRecorder | None]:
    return contextlib.nullcontext() if folder is None else DemoRecorder(folder)


def _echo_next(folder: Path, drive: Path) -> None:
    """What can be done with what was recorded, to be typed."""
    click.echo(f"recorded in {drive}; next:")
    for line in (
        f"recordings check --folder {shlex.quote(str(folder))}",
        f"replay {shlex.quote(str(drive))}",
        f"replay {shlex.quote(str(drive))} --set {_WHAT_IF} --html what-if.html",
    ):
        click.echo(f"  vcu-gateway {line}")


def _print(picture: Callable[[], str], child: DemoProcess) -> None:
    """The picture now and then, for a pipe or a file."""
    with stopped_by_signals() as stop:
        while not stop.wait(_PLAIN_EVERY_S) and not child.has_ended():
            click.echo(picture())


def _vcan0_is_up() -> bool:
    """True where this kernel has CAN and vcan0 is up."""
    with contextlib.closing(Interfaces()) as interfaces:
        found = interfaces.look("vcan0")
    return found is not None and found.up and can_socket_error() is None
