"""The start of the whole program: the API is open before the first tick."""

from pathlib import Path

import pytest

from vcu_gateway import config as configuration
from vcu_gateway.app import Application
from vcu_gateway.client import ApiError, Client
from vcu_gateway.config.protocol import load_protocol


@pytest.fixture
def application(tmp_path: Path) -> Application:
    file = tmp_path / "gateway.yaml"
    file.write_text(
        f"bus: {{interface: virtual, channel: {tmp_path.name}}}\n"
        f"api: {{socket_path: {tmp_path / 'control.sock'}}}\n"
    )
    loaded = configuration.load(file)
    return Application(loaded, load_protocol(loaded))


def test_before_the_first_tick_whoever_asks_is_told_to_try_again(application, tmp_path):
    with application.api, Client(tmp_path / "control.sock") as client:
        for ask in (client.why, client.state):
            with pytest.raises(ApiError, match="the gateway has not ticked yet; try again"):
                ask()
        assert client.config()["digest"], "what no tick is needed for is answered"


def test_an_api_that_cannot_be_opened_is_reported_and_the_gateway_runs_without(
    application, tmp_path
):
    (tmp_path / "control.sock").write_text("a file of somebody else's")
    with application.api:
        application.run(0.2)
    (told,) = [
        entry.event
        for entry in application.loop.event_log.latest(50)
        if entry.event.name == "api_unavailable"
    ]
    assert "control.sock" in str(told.fields["reason"])
    assert application.loop.schedule.ticks > 0
    assert (tmp_path / "control.sock").read_text() == "a file of somebody else's"
