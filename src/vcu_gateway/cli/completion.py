"""`vcu-gateway completion`: completion script of a shell."""

import click
from click.shell_completion import get_completion_class

_FILES = {
    "bash": "/etc/bash_completion.d/vcu-gateway",
    "zsh": "/usr/share/zsh/vendor-completions/_vcu-gateway",
    "fish": "/usr/share/fish/vendor_completions.d/vcu-gateway.fish",
}


@click.command("completion")
@click.argument("shell", type=click.Choice(list(_FILES)))
@click.pass_context
def command(context: click.Context, shell: str) -> None:
    """Print the completion script of a shell.

    \b
    For one user:   vcu-gateway completion bash >> ~/.bashrc
    For everybody:  vcu-gateway completion bash | sudo tee /etc/bash_completion.d/vcu-gateway
    """  # noqa: D301 - click knows \\b as a character
    kind = get_completion_class(shell)
    if kind is None:
        raise click.UsageError(f"{shell} is not supported by this version of click")
    program = context.find_root().command
    click.echo(kind(program, {}, "vcu-gateway", "_VCU_GATEWAY_COMPLETE").source())
