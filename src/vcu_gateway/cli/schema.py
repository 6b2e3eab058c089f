"""`vcu-gateway schema`: JSON Schema and defaults of the configuration, OpenRPC of the API."""

import json

import click


@click.command("schema")
@click.option("--yaml", "as_yaml", is_flag=True, help="Print every key at its default, as YAML.")
@click.option("--api", "of_api", is_flag=True, help="Of the API instead: an OpenRPC document.")
def command(as_yaml: bool, of_api: bool) -> None:
    """Print the JSON Schema of the configuration file.

    With it an editor completes and checks keys: save it as schema.json beside the
    configuration and begin that file with `# yaml-language-server: $schema=schema.json`.
    """
    if as_yaml and of_api:
        raise click.UsageError("--yaml and --api exclude each other")
    if as_yaml:
        from vcu_gateway.protocol import packaged

        click.echo(packaged("gateway.yaml").read_text(encoding="utf-8"), nl=False)
    elif of_api:
        from vcu_gateway.api import openrpc

        click.echo(json.dumps(openrpc.document(), indent=2))
    else:
        from vcu_gateway import config

        click.echo(json.dumps(config.schema(), indent=2))
