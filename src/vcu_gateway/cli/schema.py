"""`vcu-gateway schema`: what a configuration file or the API may hold, for editors and programs."""

import json

import click


@click.command("schema")
@click.option("--api", "of_api", is_flag=True, help="Of the API instead: an OpenRPC document.")
@click.option("--page", "as_page", is_flag=True, help="With --api: its part of docs/api.md.")
def command(of_api: bool, as_page: bool) -> None:
    """Print the JSON Schema of the configuration file.

    With it an editor completes and checks keys: save it as schema.json beside the
    configuration and begin that file with `# yaml-language-server: $schema=schema.json`.
    """
    if as_page and not of_api:
        raise click.UsageError("--page needs --api")
    if of_api:
        from vcu_gateway.api import docs_page, openrpc

        document = openrpc.document()
        click.echo(
            docs_page.page(document) if as_page else json.dumps(document, indent=2), nl=not as_page
        )
        return
    from vcu_gateway import config

    click.echo(json.dumps(config.schema(), indent=2))
