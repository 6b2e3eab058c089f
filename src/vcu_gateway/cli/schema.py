"""`vcu-gateway schema`: JSON Schema and defaults of the configuration, OpenRPC of the API."""

import json
from pathlib import Path

import click

_GATEWAY_YAML = Path("config/gateway.yaml")
_COMMAND_LINE = f"vcu-gateway schema --yaml >{_GATEWAY_YAML}"


@click.command("schema")
@click.option("--yaml", "as_yaml", is_flag=True, help="Print every key at its default, as YAML.")
@click.option(
    "--check", is_flag=True, help=f"With --yaml: exit 1 where {_GATEWAY_YAML} is something else."
)
@click.option("--api", "of_api", is_flag=True, help="Of the API instead: an OpenRPC document.")
@click.option("--page", "as_page", is_flag=True, help="With --api: its part of docs/api.md.")
def command(as_yaml: bool, check: bool, of_api: bool, as_page: bool) -> None:
    """Print the JSON Schema of the configuration file.

    With it an editor completes and checks keys: save it as schema.json beside the
    configuration and begin that file with `# yaml-language-server: $schema=schema.json`.
    """
    if as_page and not of_api:
        raise click.UsageError("--page needs --api")
    if check and not as_yaml:
        raise click.UsageError("--check needs --yaml")
    if as_yaml and of_api:
        raise click.UsageError("--yaml and --api exclude each other")
    if of_api:
        _api(as_page)
    elif as_yaml:
        _yaml(check)
    else:
        from vcu_gateway import config

        click.echo(json.dumps(config.schema(), indent=2))


def _api(as_page: bool) -> None:
    from vcu_gateway.api import docs_page, openrpc

    document = openrpc.document()
    text = docs_page.page(document) if as_page else json.dumps(document, indent=2)
    click.echo(text, nl=not as_page)


def _yaml(check: bool) -> None:
    from vcu_gateway.cli import generated
    from vcu_gateway.config import gateway_yaml

    if check:
        generated.check({_GATEWAY_YAML: gateway_yaml.text()}, "the model", _COMMAND_LINE)
    else:
        click.echo(gateway_yaml.text(), nl=False)
