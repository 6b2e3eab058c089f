"""The other side. Tests of `gateway` need a healthy one; those of `fake` break it."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.client.asyncio_bridge import Bridged
from tests.client.fake_gateway import FakeGateway
from vcu_gateway.client import Client


@pytest.fixture
def fake(tmp_path: Path) -> Iterator[FakeGateway]:
    """A gateway that can be told to misbehave."""
    fake = FakeGateway(tmp_path / "control.sock")
    fake.start()
    yield fake
    fake.stop()


@pytest.fixture
def gateway(fake: FakeGateway) -> Path:
    """The socket of a healthy gateway in standby; the real one can take this place."""
    return fake.path


@pytest.fixture(params=[Client, Bridged], ids=["threads", "asyncio"])
def kind(request: pytest.FixtureRequest) -> Callable[..., Any]:
    """Both clients, one after the other."""
    chosen: Callable[..., Any] = request.param
    return chosen
