"""The start of the whole program, with an API before the first tick, without one, and its end."""

from pathlib import Path

import pytest

from vcu_gateway import config as configuration
from vcu_gateway.app import Application
from vcu_gateway.client import ApiError, Client, ClientError
from vcu_gateway.config.checks import load_protocol
from vcu_gateway.core.causes import Event
from vcu_gateway.server.dispatch import Dispatcher


@pytest.fixture
def application(tmp_path: Path) -> Application:
    file = tmp_path / "gateway.yaml"
    file.write_text(
        f"bus: {{interface: virtual, channel: {tmp_path.name}}}\n"
        f"api: {{socket_path: {tmp_path / 'control.sock'}}}\n"
    )
    loaded = configuration.load(file)
    return Application(loaded, load_protocol(loaded))


def the_only(application: Application, name: str) -> Event:
    """The one event of this name, which happened once."""
    logged = application.loop.event_log.latest(50)
    (entry,) = [entry for entry in logged if entry.event.name == name]
    assert entry.count == 1
    return entry.event


def test_before_the_first_tick_whoever_asks_is_told_to_try_again(application, tmp_path):
    with application.api, Client(tmp_path / "control.sock") as client:
        for ask in (client.why, client.state, client.arm):
            with pytest.raises(ApiError, match="the gateway has not ticked yet; try again"):
                ask()
        assert client.config()["digest"], "what no tick is needed for is answered"


def test_an_api_that_cannot_be_opened_is_reported_and_the_gateway_runs_without(
    application, tmp_path
):
    (tmp_path / "control.sock").write_text("a file of somebody else's")
    with application.api:
        application.run(0.2)
    told = the_only(application, "api_unavailable")
    assert "control.sock" in str(told.fields["reason"])
    assert application.loop.schedule.ticks > 0
    assert (tmp_path / "control.sock").read_text() == "a file of somebody else's"


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_bug_that_ends_the_api_is_one_event_and_the_gateway_ticks_on(
    application, tmp_path, monkeypatch
):
    def broken(*_: object) -> None:
        raise ZeroDivisionError("never thought of")

    with application.api:
        monkeypatch.setattr(Dispatcher, "handle", broken)
        with pytest.raises(ClientError), Client(tmp_path / "control.sock") as client:
            client.why()
        application.run(0.3)
    told = the_only(application, "api_failed")
    assert told.fields == {"reason": "ZeroDivisionError('never thought of')"}
    assert application.loop.schedule.ticks > 1
