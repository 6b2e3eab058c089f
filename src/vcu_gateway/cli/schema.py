"""`vcu-gateway schema`: what a configuration file may hold, for editors."""

import json

import click

from vcu_gateway import config


@click.command("schema")
def command() -> None:
    """Print the JSON Schema of the configuration file.

    With it an editor completes and checks keys: save it as schema.json beside the
    configuration and begin that file with `# yaml-language-server: $schema=schema.json`.
    """
    click.echo(json.dumps(config.schema(), indent=2))
