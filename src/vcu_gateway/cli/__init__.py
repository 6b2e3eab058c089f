"""The command line: one module a verb, imported only when it is called."""

import contextlib
import functools
import importlib
import os
import signal
import sys
from collections.abc import Callable, Iterator
from typing import Any

import click

from vcu_gateway import streams
from vcu_gateway.errors import GatewayError

_VERBS = {
    "run": "run the gateway on the bus",
    "status": "the running gateway in a few lines",
    "why": "why the vehicle does or does not move, and what to do next",
    "watch": "the running gateway live, filling the terminal",
    "demand": "hold throttle and brake from a terminal",
    "arm": "let the vehicle move: from standby to active",
    "disarm": "end the drive: from active to standby",
    "reset": "from a latched fault to standby",
    "estop": "emergency stop: cut the power now",
    "events": "what happened lately, counted",
    "reload": "read the configuration file again, all of it or nothing",
    "simulate": "play the vehicle: BMS, IMU, ARD2 and both motor controllers",
    "demo": "gateway and simulated vehicle together, live",
    "decode": "decode a recording to JSON lines or CSV",
    "check-config": "check a configuration file",
    "doctor": "check this machine, and say what mends it",
    "schema": "JSON Schema of the configuration, OpenRPC document of the API",
    "dbc": "generate the DBC and the protocol page, or check that they are current",
    "completion": "print the completion script of a shell",
    "version": "print the versions that matter for a bug report",
}

_EPILOG = """\b
Exit codes: 0 done, 1 a check answered no, 2 wrong command line, 65 wrong file contents,
66 unreadable file, 69 bus, gateway or part not available, 70 bug in this program, 75 refused
or not answered in time, 77 not permitted, 78 wrong configuration.
A first look: vcu-gateway demo"""


class _ReaderGoneError(Exception):
    """Whoever read our output has gone (`| head`)."""


@contextlib.contextmanager
def _without_a_reader() -> Iterator[None]:
    """Say it in our own words: click makes exit code 1 of a broken pipe."""
    try:
        yield
    except BrokenPipeError as error:
        raise _ReaderGoneError from error


class _Verbs(click.Group):
    """Knows every verb's name and help without importing it."""

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        with _without_a_reader():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> object:
        with _without_a_reader():
            return super().invoke(ctx)

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return list(_VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        del ctx
        if cmd_name not in _VERBS:
            return None
        module = importlib.import_module(f"vcu_gateway.cli.{cmd_name.replace('-', '_')}")
        command: click.Command = module.command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl(list(_VERBS.items()))


@click.group(cls=_Verbs, epilog=_EPILOG, context_settings={"help_option_names": ["-h", "--help"]})
def group() -> None:
    """Vehicle-control-unit gateway for a two-motor electric vehicle on Linux SocketCAN.

    It decodes what the battery, the inertial unit, the steering and wheel sensors and both
    motor controllers send, and sends each controller one command frame every 50 ms.
    """


def main() -> None:
    """Entry point: every expected failure is a line on stderr and an exit code."""
    _fill_standard_descriptors()
    try:
        group.main(standalone_mode=False, prog_name="vcu-gateway")
        with _without_a_reader():
            _flush()
    except click.ClickException as error:
        _tell(error.show)
        sys.exit(error.exit_code)
    except click.exceptions.Abort:
        sys.exit(128 + signal.SIGINT)
    except GatewayError as error:
        for problem in error.problems:
            _tell(functools.partial(click.echo, f"error: {problem}", err=True))
        sys.exit(error.exit_code)
    except _ReaderGoneError:
        sys.exit(0)  # nobody is left to tell
    finally:
        streams.flush()


def _fill_standard_descriptors() -> None:
    """Where one is closed, put /dev/null: else the bus's socket would get its number."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free


def _flush() -> None:
    if sys.stdout is not None:  # closed before the program began
        sys.stdout.flush()


def _tell(say: Callable[[], None]) -> None:
    """Say it on stderr, where anybody reads it."""
    with contextlib.suppress(OSError):
        say()
