"""`vcu-gateway demo` and `watch`: the live view of a simulated vehicle or a running gateway."""

import contextlib
import os
import shlex
import shutil
import signal
import sys
import threading
import time
import webbrowser
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import click

from vcu_gateway.bus.interface import Interfaces, can_socket_error
from vcu_gateway.cli.options import (
    config_file_option,
    duration_option,
    file_option,
    socket_option,
    stopped_by_signals,
    tui_needed,
    web_needed,
)
from vcu_gateway.client.jsonrpc import SOCKET_VARIABLE
from vcu_gateway.demo.process import DemoOptions, DemoProcess, DemoRecorder, default_socket, load
from vcu_gateway.errors import Problem, UnavailableError


@click.command("watch")
@socket_option
def watch(socket_path: Path | None) -> None:
    """Show the running gateway live: mode and why, commanded beside reported, every signal.

    It only reads; E (after e) is the emergency stop and D (after d) disarms. ? lists the keys.
    A gateway that goes away is waited for. NO_COLOR is respected.
    """
    with tui_needed():
        from vcu_gateway.watch import terminal
        from vcu_gateway.watch.source import GatewaySource
    if not terminal.is_full():
        remedy = "`vcu-gateway status` prints the same once, as text or JSON"
        what = "the live view needs a terminal for input, output and errors"
        raise UnavailableError(Problem(what, remedy=remedy))
    with GatewaySource(socket_path) as source:
        terminal.watch(source, "vcu-gateway")


_PLAIN_EVERY_S, _LOOK_EVERY_S = 2.0, 0.2
_PAGE = ("127.0.0.1", 9465)
_NAME = "vcu-gateway"
_TITLE = f"{_NAME} demo"
_WHAT_IF = "limits.throttle_slew_pct_per_s=10"


@click.command("demo")
@duration_option("Stop by itself after so long; default: q or Ctrl-C.")
@click.option(
    "--throttle",
    "throttle_pct",
    type=click.FloatRange(0, 100),
    show_default="the configuration's, else 30",
    help="Static demand for both controllers, %.",
)
@click.option(
    "--no-demand",
    is_flag=True,
    help="Demand nothing, so that another program may drive, as docs/examples do.",
)
@config_file_option(
    "Configuration, with the demo's bus and sockets in place of its own.", type=click.Path()
)
@file_option(
    "--scenario",
    "scenario_path",
    type=click.Path(),
    help="What breaks, and when: docs/simulator.md.",
)
@click.option(
    "--pedals",
    "has_pedals",
    is_flag=True,
    help="Drive with a pedal node on CAN: that of -c FILE, else of config/examples/pedals.yaml.",
)
@click.option(
    "--battery-speedup",
    type=click.FloatRange(0, 10_000),
    show_default="the scenario's, else 20",
    help="Factor of the battery's charge and discharge, to see it drain.",
)
@file_option(
    "--socket",
    "socket_path",
    metavar="PATH",
    show_default="vcu-gateway-demo.sock in $XDG_RUNTIME_DIR, else in /tmp with the user's number",
    help="Where it answers other programs.",
)
@click.option(
    "--record",
    "folder",
    metavar="DIR",
    type=click.Path(file_okay=False, path_type=Path),
    help="Record the drive into DIR; the last lines say what can be done with it.",
)
@click.option("--web", "in_browser", is_flag=True, help="Show it in a browser, not here.")
def demo(
    throttle_pct: float | None,
    no_demand: bool,
    socket_path: Path | None,
    folder: Path | None,
    in_browser: bool,
    **options: Any,
) -> None:
    """Show gateway and simulated vehicle together, live, as `watch` shows a real one.

    Uses vcan0 where there is one that is up, else python-can's virtual bus inside a process of
    its own; the first line says which, the next one what another terminal needs so that its
    commands reach this gateway. No hardware is touched. Without a terminal the same is printed as
    text every 2 s. With --web it is shown as `vcu-gateway web` shows a real one.
    """
    if no_demand and throttle_pct is not None:
        raise click.UsageError("--no-demand and --throttle contradict each other")
    interface, channel = ("socketcan", "vcan0") if _vcan0_is_up() else ("virtual", "in-process")
    socket = str((socket_path or default_socket()).absolute())
    wanted = DemoOptions(interface, channel, socket, throttle_pct, not no_demand, **options)
    if wanted.config_path is not None or wanted.scenario_path is not None:
        load(wanted)  # for its errors, before anything starts
    with _recorder(folder) as recorder:
        if recorder is not None:
            wanted = wanted._replace(recorder_socket=str(recorder.socket_path))
        summary = (_in_browser if in_browser else _in_terminal)(wanted, folder)
    click.echo(summary)
    if recorder is not None and recorder.drive is not None:
        _echo_next(recorder.folder, recorder.drive)


def _in_terminal(wanted: DemoOptions, recordings: Path | None) -> str:
    """Show it here; the summary."""
    with tui_needed():
        from vcu_gateway.watch import terminal
        from vcu_gateway.watch.signals import plain
        from vcu_gateway.watch.source import GatewaySource
    with DemoProcess(wanted) as child, GatewaySource(child.socket_path) as source:
        click.echo(f"{_TITLE} on {wanted.channel} ({wanted.interface}), until q or Ctrl-C")
        _echo_for_others(wanted, recordings)
        if terminal.is_full():
            terminal.watch(
                source,
                _TITLE,
                child.has_ended,
                notes=lambda: [_export_line(wanted), *child.notes[-1:]],
            )
            _echo_all(child.notes)
        else:
            _print(lambda: plain(_TITLE, source.latest()), child)
    return child.summary


def _in_browser(wanted: DemoOptions, recordings: Path | None) -> str:
    """Serve the page until Ctrl-C or the end; the summary."""
    with web_needed():
        from vcu_gateway.web import application
        from vcu_gateway.web.settings import WebSettings
        from vcu_gateway.web.users import UserRole, WebEvents
    with DemoProcess(wanted) as child:
        settings = WebSettings(
            *_PAGE, child.socket_path, local_role=UserRole.SERVICE, recordings=recordings
        )
        app = application.build(settings, WebEvents(lambda _: None))
        stopped = threading.Event()

        def on_ready(address: str) -> None:
            click.echo(f"{_TITLE} on {wanted.channel}: {address} (Ctrl-C ends it)")
            _echo_for_others(wanted, recordings)
            threading.Thread(target=_follow, args=(child, stopped), daemon=True).start()
            if os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
                webbrowser.open(address)  # in this desktop's, where there is one

        try:
            application.run(settings, app, on_ready)
        finally:
            stopped.set()
    return child.summary


def _follow(child: DemoProcess, stopped: threading.Event) -> None:
    """Print the scenario's steps; end the page's server as Ctrl-C does, if the child ends first."""
    shown = 0
    while not stopped.wait(_LOOK_EVERY_S):
        shown += _echo_all(child.notes[shown:])
        if child.has_ended():
            signal.raise_signal(signal.SIGINT)
            return


def _recorder(folder: Path | None) -> AbstractContextManager[DemoRecorder | None]:
    return contextlib.nullcontext() if folder is None else DemoRecorder(folder)


def _echo_for_others(wanted: DemoOptions, recordings: Path | None) -> None:
    """What another terminal needs, to be typed there."""
    click.echo(f"in another terminal:\n  {_export_line(wanted)}\n  {_program()} why")
    if recordings is not None:
        folder = shlex.quote(str(recordings))
        click.echo(f"  {_program()} recordings keep now --folder {folder}")
    click.echo()


def _export_line(wanted: DemoOptions) -> str:
    return f"export {SOCKET_VARIABLE}={shlex.quote(wanted.socket_path)}"


def _program() -> str:
    """The program as it was called, to be typed again; its name where that is enough."""
    called, found = Path(sys.argv[0]), shutil.which(_NAME)
    if called.name != _NAME or (found is not None and called.samefile(found)):
        return _NAME
    return shlex.quote(str(called))


def _echo_next(folder: Path, drive: Path) -> None:
    """What can be done with what was recorded, to be typed."""
    click.echo(f"recorded in {drive}; next:")
    for line in (
        f"recordings check --folder {shlex.quote(str(folder))}",
        f"replay {shlex.quote(str(drive))}",
        f"replay {shlex.quote(str(drive))} --set {_WHAT_IF} --html what-if.html",
    ):
        click.echo(f"  {_program()} {line}")


def _print(picture: Callable[[], str], child: DemoProcess) -> None:
    """The picture now and then and the scenario's steps as they come, for a pipe or a file."""
    shown, next_s = 0, time.monotonic() + _PLAIN_EVERY_S
    with stopped_by_signals() as stop:
        while not stop.wait(_LOOK_EVERY_S) and not child.has_ended():
            shown += _echo_all(child.notes[shown:])
            if time.monotonic() >= next_s:
                next_s += _PLAIN_EVERY_S
                click.echo(picture())


def _echo_all(notes: list[str]) -> int:
    """Print them; how many they are."""
    for note in notes:
        click.echo(note)
    return len(notes)


def _vcan0_is_up() -> bool:
    """True where this kernel has CAN and vcan0 is up."""
    with contextlib.closing(Interfaces()) as interfaces:
        found = interfaces.look("vcan0")
    return found is not None and found.up and can_socket_error() is None
