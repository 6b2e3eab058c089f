"""Shared by the verbs that use the API: options, connection, printing, exit codes."""

import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import click

from vcu_gateway.cli.options import socket_option
from vcu_gateway.client import (
    ApiError,
    Client,
    ClientError,
    ConfigRefusedError,
    NoRightError,
    UnreachableError,
)
from vcu_gateway.errors import (
    ConfigError,
    NotPermittedError,
    Problem,
    RequestRefusedError,
    UnavailableError,
)

_Command = TypeVar("_Command", bound=Callable[..., Any])

json_option = click.option("--json", "as_json", is_flag=True, help="One JSON object.")


def api_options(command: _Command) -> _Command:
    return socket_option(json_option(command))


@contextlib.contextmanager
def connected(socket_path: Path | None) -> Iterator[Client]:
    """Client whose errors become a line on stderr and an exit code."""
    with command_line_errors(), Client(socket_path) as client:
        yield client


@contextlib.contextmanager
def command_line_errors() -> Iterator[None]:
    """Errors of the client as errors with an exit code."""
    try:
        yield
    except ConfigRefusedError as error:
        raise ConfigError(*map(Problem, error.problems or (error.sentence,))) from error
    except NoRightError as error:
        raise NotPermittedError(Problem(error.sentence)) from error
    except ApiError as error:
        raise RequestRefusedError(Problem(error.sentence)) from error
    except UnreachableError as error:
        forbidden = isinstance(error.__cause__, PermissionError)
        raise (NotPermittedError if forbidden else UnavailableError)(Problem(str(error))) from error
    except ClientError as error:
        raise RequestRefusedError(Problem(str(error))) from error


def show(result: Any, as_json: bool, text: Callable[[], str]) -> None:
    click.echo(json.dumps(result, ensure_ascii=False) if as_json else text())
