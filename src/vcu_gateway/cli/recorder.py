"""`vcu-gateway recorder`: every drive of the gateways of this machine on disk, bounded."""

from pathlib import Path
from typing import Any

import click

from vcu_gateway.cli.options import ANY_PATH, Option, file_option
from vcu_gateway.recorder import DEFAULT_SOCKET, RecorderOptions, size_bytes
from vcu_gateway.recorder.program import Recorder
from vcu_gateway.recording.layout import DEFAULT_FOLDER
from vcu_gateway.text import say


def _size(context: click.Context, parameter: click.Parameter, text: str) -> int:
    """Bytes of SIZE: a number with k, M, G or T behind it."""
    del context, parameter
    try:
        return size_bytes(text)
    except ValueError as error:
        raise click.BadParameter(str(error)) from error


def _size_option(name: str, default: str, text: str) -> Option:
    return click.option(
        name, metavar="SIZE", default=default, show_default=True, callback=_size, help=text
    )


def _seconds_option(name: str, parameter: str, default: float, text: str) -> Option:
    return click.option(
        name,
        parameter,
        type=click.FloatRange(0, 600),
        metavar="SECONDS",
        default=default,
        show_default=True,
        help=text,
    )


@click.command("recorder")
@click.option(
    "--folder",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="DIR",
    default=DEFAULT_FOLDER,
    show_default=True,
    help="Where drives and incidents are kept.",
)
@file_option(
    "--socket",
    "socket_path",
    type=ANY_PATH,  # systemd's, which only gateways may open
    metavar="PATH",
    default=DEFAULT_SOCKET,
    show_default=True,
    help="Where gateways connect, unless the service manager hands a socket over.",
)
@_size_option("--max-bytes", "4G", "Of all drives; the oldest segments go above it.")
@_size_option("--keep-free-bytes", "1G", "Of the disk; the oldest segments go below it.")
@_size_option("--incident-max-bytes", "1G", "Of all incidents.")
@_seconds_option("--incident-before-s", "before_s", 60.0, "Kept before the reason of an incident.")
@_seconds_option("--incident-after-s", "after_s", 30.0, "Kept after it.")
@_size_option("--memory-bytes", "32M", "Of what waits for a disk that is slow or full.")
@file_option(
    "--status",
    "status_path",
    help="Tell once a second how it goes, in this file; on a tmpfs.",
)
@file_option(
    "--sign-key",
    help="Sign each segment and incident with this private key of OpenSSH, without a passphrase.",
)
@click.option(
    "--gateway-user",
    metavar="USER",
    help="Who may hand over a drive, besides root and the recorder's own user.  [default:"
    " vcu-gateway, where that user exists]",
)
def recorder(**options: Any) -> None:
    """Record what the gateways of this machine receive, decide and send.

    A program beside them, which none of them waits for. SIGUSR1 keeps what surrounds this moment
    as an incident; Ctrl-C or SIGTERM ends it in order.
    """
    Recorder(RecorderOptions(**options), say).run()
