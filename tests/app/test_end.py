"""The end of the whole program: what it leaves, and what it says."""

import pytest

from vcu_gateway import config as configuration
from vcu_gateway.app import Application
from vcu_gateway.config.checks import load_protocol
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.daemon.systemd import SystemdNotifier
from vcu_gateway.errors import UnavailableError

DURATION_S = 1.5  # it listens for a second before it talks


@pytest.fixture
def application(tmp_path) -> Application:
    file = tmp_path / "gateway.yaml"
    file.write_text(
        f"bus: {{interface: virtual, channel: {tmp_path.name}}}\napi: {{enabled: false}}\n"
    )
    loaded = configuration.load(file)
    application = Application(loaded, load_protocol(loaded))
    application.begin_service(SystemdNotifier({}, 1), tmp_path)
    return application


def test_an_orderly_end_leaves_no_safe_frames(application, tmp_path):
    application.run(DURATION_S)
    assert application.loop.connection.counters.sent > 0
    assert not (tmp_path / "safe-frames").exists()


def test_an_end_on_a_bus_that_takes_nothing_is_an_error_and_leaves_the_safe_frames(
    application, tmp_path, monkeypatch
):
    connection, gateway = application.loop.connection, application.loop.gateway
    send = connection.send
    monkeypatch.setattr(
        connection,
        "send",
        lambda frame: (
            connection.count_unsent("full") if gateway.mode is Mode.STOPPING else send(frame)
        ),
    )
    with pytest.raises(UnavailableError, match="its last safe frames did not leave"):
        application.run(DURATION_S)
    assert connection.counters.sent > 0
    assert (tmp_path / "safe-frames").exists()
