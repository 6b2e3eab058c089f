"""The other side. Tests of `gateway` need a healthy one; those of `standin` break it."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.client.asyncio_bridge import Bridged
from tests.client.fake_gateway import Standin
from vcu_gateway.client import Client


@pytest.fixture
def standin(tmp_path: Path) -> Iterator[Standin]:
    """A gateway that can be told to misbehave."""
    standin = Standin(tmp_path / "control.sock")
    standin.start()
    yield standin
    standin.stop()


@pytest.fixture
def gateway(standin: Standin) -> Path:
    """The socket of a healthy gateway in standby; the real one can take this place."""
    return standin.path


@pytest.fixture(params=[Client, Bridged], ids=["threads", "asyncio"])
def kind(request: pytest.FixtureRequest) -> Callable[..., Any]:
    """Both clients, one after the other."""
    chosen: Callable[..., Any] = request.param
    return chosen
