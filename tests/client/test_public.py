"""What a program sees of the package, and what importing it costs."""

import subprocess
import sys

import pytest

from vcu_gateway import client

HEAVY = ("pydantic", "can", "cantools", "click", "structlog", "yaml", "textual", "asyncio")
GATEWAY = tuple(f"vcu_gateway.{name}" for name in ("bus", "config", "core", "daemon", "server"))


def modules_after(statement):
    program = f"{statement}; import sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


def test_importing_the_client_is_light():
    loaded = modules_after("import vcu_gateway.client")
    assert loaded.isdisjoint(HEAVY)
    assert {name for name in loaded if name.startswith("vcu_gateway.api")} <= {
        "vcu_gateway.api",
        "vcu_gateway.api.results",
        "vcu_gateway.api.errors",
    }


def test_the_client_needs_no_other_package_and_nothing_of_the_gateway():
    absent = (*HEAVY, "rich", "prometheus_client", *GATEWAY)
    without = "; ".join(f"sys.modules[{name!r}] = None" for name in absent)
    loaded = modules_after(f"import sys; {without}; from vcu_gateway.client import Client")
    assert "vcu_gateway.client.sync_client" in loaded


def test_only_the_asyncio_client_loads_asyncio():
    loaded = modules_after("from vcu_gateway.client import AsyncClient")
    assert "asyncio" in loaded
    assert loaded.isdisjoint(set(HEAVY) - {"asyncio"})


def test_every_public_name_is_there_and_documented():
    for name in client.__all__:
        assert getattr(client, name).__doc__


def test_a_name_that_is_not_there_is_an_attribute_error():
    with pytest.raises(AttributeError, match="Clint"):
        client.Clint  # noqa: B018


def test_every_error_is_a_client_error():
    errors = [getattr(client, name) for name in client.__all__ if name.endswith("Error")]
    assert len(errors) >= 9
    assert all(issubclass(error, client.ClientError) for error in errors)
