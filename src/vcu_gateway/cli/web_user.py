"""`vcu-gateway web-user`: a line for the users file of the page."""

import click

from vcu_gateway.cli.web import ROLES
from vcu_gateway.web import users
from vcu_gateway.web.users import UserRole


@click.command("web-user")
@click.argument("name")
@click.option(
    "--role", type=click.Choice(ROLES), default="viewer", show_default=True, help="What they may."
)
def command(name: str, role: str) -> None:
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
