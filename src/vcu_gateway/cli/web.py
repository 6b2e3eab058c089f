"""`vcu-gateway web` and `web-user`: the page that shows what the vehicle does, and its users."""

from pathlib import Path
from typing import Any

import click

from vcu_gateway.cli.options import (
    ANY_PATH,
    ListenAddress,
    Option,
    file_option,
    listen_option,
    socket_option,
    web_needed,
)
from vcu_gateway.client import default_socket_path
from vcu_gateway.text import say
from vcu_gateway.web import users
from vcu_gateway.web.settings import TlsFiles, WebSettings
from vcu_gateway.web.users import UserRole


def _role_option(name: str, text: str) -> Option:
    roles = click.Choice([role.value for role in UserRole])
    return click.option(name, type=roles, default="viewer", show_default=True, help=text)


@click.command("web")
@socket_option
@listen_option("127.0.0.1:9465", "Where browsers reach it; from a network only with TLS and users.")
@file_option("--users", "users_file", type=ANY_PATH, help="Users of the page.")
@_role_option("--local-role", "Role of everybody who reaches 127.0.0.1, where there are no users.")
@file_option("--certificate", type=ANY_PATH, help="TLS certificate chain, PEM.")
@file_option("--key", type=ANY_PATH, help="Its key, PEM.")
@click.option(
    "--host-name",
    "host_names",
    metavar="NAME",
    multiple=True,
    help="Further name that browsers know this machine by; may be given again.",
)
@file_option("--recordings", metavar="FOLDER", type=ANY_PATH, help="Folder of the recorder.")
@click.option(
    "--session-hours",
    metavar="HOURS",
    type=click.FloatRange(min=0, min_open=True, max=24 * 30),
    default=12.0,
    show_default=True,
    help="Time until one has to sign in again.",
)
@file_option(
    "--sessions",
    "state_file",
    type=ANY_PATH,
    help="Where sessions are kept over a restart of this program.",
)
def web(**options: Any) -> None:
    """Serve a page that shows what the vehicle does, and stops it.

    A program beside the gateway, with one subscription to it however many browsers look. It is
    never a source of demand. Without options nobody but this machine reaches it:
    ssh -L 9465:127.0.0.1:9465 VEHICLE brings it to another one. Ctrl-C or SIGTERM ends it.
    """
    with web_needed():
        from vcu_gateway.web import application
    settings = _settings(**options)
    settings.check()
    application.run(
        settings,
        application.build(settings, users.WebEvents()),
        lambda url: say(f"page of {settings.socket_path} at {url}"),
    )


def _settings(
    listen: ListenAddress,
    socket_path: Path | None,
    users_file: Path | None,
    local_role: str,
    certificate: Path | None,
    key: Path | None,
    session_hours: float,
    **others: Any,
) -> WebSettings:
    if (certificate is None) != (key is None):
        raise click.UsageError("--certificate and --key belong together")
    return WebSettings(
        *listen,
        socket_path=socket_path or default_socket_path(),
        users=users.read(users_file) if users_file else {},
        local_role=UserRole(local_role),
        tls=TlsFiles(certificate, key) if certificate and key else None,
        session_lifetime_s=session_hours * 3600,
        **others,
    )


@click.command("web-user")
@click.argument("name")
@_role_option("--role", "What they may.")
def web_user(name: str, role: str) -> None:
    """Print a line for the users file of `vcu-gateway web`; the password is asked for.

    viewer: look, stop and disarm. operator: arm, reset at driver level, recordings, too. service:
    reset at service level, too. The web page's own user needs the right in the gateway's
    configuration, as well (docs/web.md).
    """
    if not users.is_name(name):
        raise click.BadParameter("1 to 32 of the characters A-Z a-z 0-9 _ . -", param_hint="NAME")
    password = click.prompt("Password", hide_input=True, confirmation_prompt=True, err=True)
    least, most = users.LEAST_PASSWORD_CHARACTERS, users.MOST_PASSWORD_CHARACTERS
    if not least <= len(password) <= most:
        raise click.UsageError(f"a password has {least} to {most} characters")
    click.echo(users.User(name, UserRole(role), users.PasswordHash.of(password)).line())
