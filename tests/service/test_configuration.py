"""A configuration that is wrong, missing or unreadable: at the start and while it runs."""

import os
import subprocess
import time
from collections.abc import Callable

import pytest

from tests.service.conftest import configure
from tests.service.driver import Driver
from tests.service.unit import CONFIG, NAME, Unit, systemctl

pytestmark = pytest.mark.ci

RESTART_S = 0.2  # RestartSec=
GOOD, WRONG, STRICTER = (f"power_limit_max_w: {watts}" for watts in (60000, 99000, 40000))


def test_a_wrong_configuration_stays_down_with_its_reason_until_it_is_corrected(
    unit: Unit, driver: Driver, vehicle: None, default_config: str
):
    since_ns = time.time_ns()
    configure(default_config.replace(GOOD, WRONG))
    assert systemctl("start", NAME).returncode != 0
    assert (unit.show("ActiveState"), unit.show("SubState")) == ("failed", "failed")
    assert unit.number("NRestarts") == 0
    unit.said("power_limit_max_w")
    assert "power_limit_max_w" in unit.status()
    assert f"{CONFIG}:" in unit.status()
    configure(default_config)
    unit.start()
    assert unit.show("SubState") == "running"
    before = driver.between(since_ns, until_ns=unit.stamp_ns("InactiveExit"))
    assert before == [], "nothing to make safe: it never drove"


def wrong() -> None:
    CONFIG.write_text("bus: {chanel: can0}\n")


REFUSED: dict[str, tuple[int, Callable[[], None]]] = {
    "wrong": (os.EX_CONFIG, wrong),
    "missing": (os.EX_NOINPUT, CONFIG.unlink),
    "unreadable": (os.EX_NOINPUT, lambda: CONFIG.chmod(0o600)),  # root's; the service is not root
}


@pytest.mark.parametrize("what", REFUSED)
def test_a_file_that_cannot_be_used_is_one_line_and_no_restart(
    unit: Unit, default_config: str, what: str
):
    code, make = REFUSED[what]
    try:
        make()
        as_service = ["runuser", "-u", "vcu-gateway", "--", "vcu-gateway"]
        asked = [*as_service, "check-config", "-c", str(CONFIG)]  # as the unit names it
        checked = subprocess.run(asked, capture_output=True, text=True)
        assert systemctl("start", NAME).returncode != 0
        unit.said("Failed with result")
        time.sleep(3 * RESTART_S)
        assert (unit.show("ActiveState"), unit.show("SubState")) == ("failed", "failed")
        assert (unit.number("ExecMainStatus"), unit.number("NRestarts")) == (code, 0)
        said = [line.text for line in unit.journal() if line.program == "vcu-gateway"]
        assert len(said) == 1, said
        assert said[0].startswith(f"error: {CONFIG}:")
        assert (checked.returncode, checked.stderr.splitlines()) == (code, said)
    finally:
        configure(default_config)
        CONFIG.chmod(0o644)


def test_a_reload_of_a_wrong_file_fails_and_changes_nothing(service: Unit, driver: Driver):
    before, pid = driver.client.config(), service.pid
    good = CONFIG.read_text()
    CONFIG.write_text(good.replace(GOOD, WRONG))
    done = systemctl("reload", NAME)
    assert done.returncode != 0
    service.said("power_limit_max_w")
    assert driver.client.config() == before
    assert service.show("ActiveState") == "active"
    CONFIG.write_text(good.replace(GOOD, STRICTER))
    assert systemctl("reload", NAME).returncode == 0
    assert driver.client.config() != before
    assert service.pid == pid
