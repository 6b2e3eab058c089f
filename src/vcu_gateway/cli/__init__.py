"""Command line: one module for a verb or a group of like verbs, imported on use."""

import contextlib
import functools
import gc
import importlib
import io
import os
import signal
import sys
from collections.abc import Callable, Iterator
from typing import Any

import click

from vcu_gateway import text
from vcu_gateway.errors import GatewayError

_VERBS = {
    "run": "run the gateway on the bus",
    "status": "the running gateway in a few lines",
    "why": "why the vehicle does or does not move, and the next step",
    "watch": "live view of the running gateway",
    "demand": "hold throttle and brake from a terminal",
    "arm": "let the vehicle move: from standby to active",
    "disarm": "end the drive: from active to standby",
    "reset": "from a latched fault to standby",
    "drive-mode": "the drive modes, or another one",
    "tuning": "where the vehicle is on each curve, and what limits it",
    "estop": "emergency stop: cut the power, and say whether it is",
    "events": "the latest events, counted",
    "reload": "read the configuration file again, all of it or nothing",
    "recorder": "keep every drive on disk, bounded",
    "recordings": "list, check, keep and remove what the recorder has written",
    "exporter": "serve the gateway's metrics to Prometheus",
    "pedals": "demand what pedals of this machine say",
    "web": "serve a page that shows what the vehicle does, and stops it",
    "web-user": "print a line for the page's users file",
    "simulate": "play the vehicle: BMS, IMU, ARD2 and both motor controllers",
    "demo": "gateway and simulated vehicle together, live",
    "decode": "decode a recording to JSON lines or CSV",
    "export": "a recorded drive or a log as HTML, CSV, MF4, Parquet or MCAP",
    "replay": "decide a recorded drive again: equal to the byte, and what if",
    "check-config": "check a configuration file",
    "doctor": "check this machine, and say how to fix what fails",
    "schema": "JSON Schema of the configuration, OpenRPC document of the API",
    "dbc": "generate the DBC, its module and the protocol page, or check that they are current",
    "completion": "print the completion script of a shell",
    "version": "print the versions that matter for a bug report",
}

MODULES = {
    **dict.fromkeys(("status", "why", "arm", "disarm", "reset", "drive-mode"), "operator"),
    **dict.fromkeys(("tuning", "estop", "events", "reload"), "operator"),
    "check-config": "run",
    "version": "about",
    "completion": "about",
    "web-user": "web",
    "watch": "demo",
    "decode": "export",
    "schema": "generate",
    "dbc": "generate",
}
"""Verb -> its module, where that has another name; the function is named as the verb."""

_EPILOG = """\b
Exit codes: 0 done, 1 a check answered no, 2 wrong command line, 3 a recording is incomplete,
65 wrong, changed or damaged file contents, 66 unreadable file, 69 bus, gateway or part not
available, 70 bug in this program, 75 refused or not answered in time, 77 not permitted,
78 wrong configuration.
A first look: vcu-gateway demo"""


class _BrokenOutputError(Exception):
    """The reader of the output has gone (`| head`)."""


@contextlib.contextmanager
def _own_broken_pipe() -> Iterator[None]:
    """Broken pipes as an error of our own: click makes exit code 1 of them."""
    try:
        yield
    except BrokenPipeError as error:
        raise _BrokenOutputError from error


class _VerbGroup(click.Group):
    """Command group that imports a verb's module when the verb is used."""

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        with _own_broken_pipe():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> object:
        with _own_broken_pipe():
            return super().invoke(ctx)

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return list(_VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        del ctx
        if cmd_name not in _VERBS:
            return None
        module = importlib.import_module(f"vcu_gateway.cli.{MODULES.get(cmd_name, cmd_name)}")
        if cmd_name != "run":  # which collects when it has time to
            gc.enable()
        command: click.Command = getattr(module, cmd_name.replace("-", "_"))
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl(list(_VERBS.items()))


@click.group(
    cls=_VerbGroup, epilog=_EPILOG, context_settings={"help_option_names": ["-h", "--help"]}
)
def group() -> None:
    """Vehicle-control-unit gateway for a two-motor electric vehicle on Linux SocketCAN.

    It decodes what the battery, the inertial unit, the steering and wheel sensors and both
    motor controllers send, and sends each controller one command frame every 50 ms.
    """


def main() -> None:
    """Entry point: every expected failure is a line on stderr and an exit code."""
    gc.disable()  # imports leave next to no garbage, and looking for it delays the first tick
    _fill_standard_descriptors()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a recording may say anything
    try:
        group.main(standalone_mode=False, prog_name="vcu-gateway")
        with _own_broken_pipe():
            _flush()
    except click.ClickException as error:
        _echo_error(error.show)
        sys.exit(error.exit_code)
    except click.exceptions.Abort:
        sys.exit(128 + signal.SIGINT)
    except GatewayError as error:
        for problem in error.problems:
            _echo_error(functools.partial(click.echo, f"error: {problem}", err=True))
        sys.exit(error.exit_code)
    except _BrokenOutputError:
        sys.exit(0)  # no reader is left
    except Exception as error:  # noqa: BLE001 - whatever it is, it is ours
        _echo_error(functools.partial(_show_bug, error))
        sys.exit(os.EX_SOFTWARE)
    finally:
        text.flush()


def _show_bug(error: Exception) -> None:
    sys.excepthook(type(error), error, error.__traceback__)
    if sys.excepthook is sys.__excepthook__:  # the gateway logs its own
        name = type(error).__name__
        click.echo(f"error: a bug in this program ({name}): report it with these lines", err=True)


def recorder() -> None:
    """Entry point of vcu-gateway-recorder: the verb `recorder` under a name of its own."""
    sys.argv.insert(1, "recorder")
    main()


def pedals() -> None:
    """Entry point of vcu-gateway-pedals: the verb `pedals` under a name of its own."""
    sys.argv.insert(1, "pedals")
    main()


def _fill_standard_descriptors() -> None:
    """Open /dev/null for each closed one: else the bus's socket would get its number."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free


def _flush() -> None:
    if sys.stdout is not None:  # closed before the program began
        sys.stdout.flush()


def _echo_error(echo: Callable[[], None]) -> None:
    """Print an error; a closed stderr is no further error."""
    with contextlib.suppress(OSError):
        echo()
