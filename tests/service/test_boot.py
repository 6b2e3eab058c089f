"""From the machine's boot to traffic on the bus; the interface comes last."""

import contextlib
import subprocess
from collections.abc import Iterator

import pytest

from tests.faults.driving import QUIET
from tests.service.conftest import Booted
from tests.service.driver import Driver
from tests.service.unit import NAME, PATIENCE_S, Unit
from tests.vcan.conftest import Stand, ip, program, wait_until

pytestmark = pytest.mark.ci


@contextlib.contextmanager
def bus_called(name: str) -> Iterator[None]:
    ip("link", "add", "dev", name, "type", "vcan")
    ip("link", "set", name, "up")
    try:
        yield
    finally:
        ip("link", "delete", name)


def test_at_boot_it_is_ready_without_its_interface_and_goes_on_unarmed_when_that_comes(
    booted: Booted, driver: Driver, stand: Stand, figures: list[str]
):
    """As installed: nobody has changed the configuration or started anything."""
    unit = Unit()
    assert booted.enabled == "enabled"
    assert (booted.state, booted.restarts) == ("active", 0)
    assert unit.pid == booted.pid, "this test is the first"
    figures.append(f"boot: READY {booted.ready_us / 1e6:.1f} s after systemd's start")
    wait_until(lambda: "can0: no such interface" in unit.show("StatusText"), "why", PATIENCE_S)
    with bus_called("can0"):
        path = stand.folder / "can0.yaml"
        path.write_text(QUIET)
        options = ("--channel", "can0", "--scenario", str(path))
        vehicle = stand.start("vehicle-can0", *program("simulate", *options))
        driver.until_standby()
        driver.until_zero_torque_alone(since_ns=0)
        wait_until(lambda: unit.show("StatusText").startswith("standby"), "standby", PATIENCE_S)
        vehicle.stop()
    wait_until(lambda: "can0" in unit.show("StatusText"), "the loss in the status", PATIENCE_S)
    assert (unit.pid, unit.number("NRestarts")) == (booted.pid, 0)


def test_this_systemd_understands_every_line_and_has_no_warning_about_one(booted: Booted):
    """What it does not know, or no longer wants, it ignores and tells in the journal."""
    both = (NAME, NAME.replace(".", "@can1."))
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", *both], capture_output=True, text=True
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert booted.warnings == []
