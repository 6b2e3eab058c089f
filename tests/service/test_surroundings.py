"""A machine that is not as it should be: nobody takes the log, a strange language and zone."""

import json
from collections.abc import Iterator
from datetime import datetime

import pytest

from tests.service.driver import Driver, gaps_ms
from tests.service.unit import Unit, systemctl

pytestmark = pytest.mark.ci

JOURNALD = [
    f"systemd-journald{part}"
    for part in (".socket", "-dev-log.socket", "-audit.socket", ".service")
]
STRANGE = ("LANG=tr_TR.UTF-8", "LC_ALL=tr_TR.UTF-8", "TZ=nonsense")
NS_PER_S = 1e9
WATCHDOG_MS = 2000
LATE_S = 60  # the journal may be; zones are quarters of an hour apart


@pytest.fixture
def journal_comes_back() -> Iterator[None]:
    yield
    systemctl("start", *JOURNALD)


def test_f65_it_drives_on_while_nobody_takes_its_log(
    service: Unit, driver: Driver, journal_comes_back: None, figures: list[str]
):
    driver.drive()
    pid = service.pid
    systemctl("stop", *JOURNALD)
    assert systemctl("is-active", "systemd-journald").stdout.strip() == "inactive"
    since_ns = driver.commands()[-1].stamp_ns
    for _ in range(10):
        driver.client.disarm()  # which it has to log, as it has the next
        driver.drive()
    widest_ms = max(gaps_ms(driver.commands(since_ns)))
    figures.append(f"journald stopped: driven on, frames at most {widest_ms:.0f} ms apart")
    assert widest_ms < WATCHDOG_MS / 2, "a write that waits would wait for ever"
    assert (service.pid, service.number("NRestarts")) == (pid, 0)


@pytest.fixture
def strange_service(unit: Unit, vehicle: None) -> Iterator[Unit]:
    systemctl("set-environment", *STRANGE)
    try:
        unit.start()
        yield unit
    finally:
        systemctl("unset-environment", *STRANGE)


def test_f83_language_and_time_zone_have_no_effect(strange_service: Unit, driver: Driver):
    driver.drive()
    with open(f"/proc/{strange_service.pid}/environ") as environment:
        assert set(STRANGE) <= set(environment.read().split("\0"))
    entry = strange_service.said("mode_changed")
    told_s = datetime.fromisoformat(json.loads(entry.text)["timestamp"]).timestamp()
    assert abs(told_s - entry.stamp_ns / NS_PER_S) < LATE_S
    assert driver.client.config()["values"]["bus"]["channel"] == "vcan0"
