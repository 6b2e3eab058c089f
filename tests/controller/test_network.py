"""The files for systemd-networkd and udev, as they are shipped, on a real controller."""

import shutil
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.controller.conftest import GATEWAY, VEHICLE, device, link, set_link
from tests.faults.driving import MS, Driving, first_frames_ms
from tests.vcan.conftest import wait_until

SHIPPED = Path(__file__).parents[2] / "systemd"
IN_EFFECT = Path("/etc/systemd/network")
FILES = ("can0.network", "10-can0.link")
RETURN_MS = 1000


class Adapter:
    """The card behind can0: pulled out and plugged in as the driver meets it."""

    def __init__(self) -> None:
        card = device(GATEWAY).resolve()
        self._driver, self._address = card.joinpath("driver").resolve(), card.name

    def unplug(self) -> None:
        (self._driver / "unbind").write_text(self._address)

    def plug(self) -> None:
        (self._driver / "bind").write_text(self._address)


@pytest.fixture
def adapter() -> Iterator[Adapter]:
    one = Adapter()
    yield one
    if not Path("/sys/class/net", GATEWAY).exists():
        one.plug()
    subprocess.run(["udevadm", "settle"], check=True)


@pytest.fixture
def networkd(adapter: Adapter) -> Iterator[None]:
    """The shipped files, put in effect as docs/install.md says; not yet started."""
    for name in FILES:
        shutil.copy(SHIPPED / name, IN_EFFECT)
    subprocess.run(["udevadm", "control", "--reload"], check=True)
    yield
    subprocess.run(
        ["systemctl", "stop", "systemd-networkd.socket", "systemd-networkd.service"], check=True
    )
    for name in FILES:
        (IN_EFFECT / name).unlink()
    subprocess.run(["udevadm", "control", "--reload"], check=True)


def start_networkd() -> None:
    subprocess.run(["systemctl", "restart", "systemd-networkd"], check=True)


def is_up(name: str) -> bool:
    return "UP" in link(name).get("flags", [])


def test_a_controller_that_is_plugged_in_is_set_as_the_files_say(adapter: Adapter, networkd: None):
    start_networkd()
    adapter.unplug()
    wait_until(lambda: link(GATEWAY) == {}, "the interface to go")
    adapter.plug()
    wait_until(lambda: is_up(GATEWAY), f"{GATEWAY} to be up")
    found = link(GATEWAY)
    assert found["txqlen"] == 4
    data = found["linkinfo"]["info_data"]
    assert data["state"] == "ERROR-ACTIVE"
    assert data["restart_ms"] == 100
    assert data["bittiming"]["bitrate"] == 250_000
    assert data["bittiming"]["sample_point"] == "0.875"
    assert data.get("ctrlmode", []) == []


def test_what_stood_otherwise_is_set_as_the_files_say(networkd: None):
    set_link(GATEWAY, "bitrate", "500000", "restart-ms", "0", "one-shot", "on", "listen-only", "on")
    subprocess.run(["ip", "link", "set", GATEWAY, "down"], check=True)
    start_networkd()
    wait_until(lambda: is_up(GATEWAY), f"{GATEWAY} to be up")
    data = link(GATEWAY)["linkinfo"]["info_data"]
    assert (data["bittiming"]["bitrate"], data["restart_ms"]) == (250_000, 100)
    assert data.get("ctrlmode", []) == []


def test_an_adapter_pulled_out_while_driving_is_set_up_by_networkd_and_used_again_unarmed(
    driving: Driving, adapter: Adapter, networkd: None, figures: list[str]
):
    start_networkd()
    wait_until(lambda: is_up(GATEWAY), f"{GATEWAY} to be up")
    driving.until_driving()
    pulled_ns = time.time_ns()
    adapter.unplug()
    driving.until_link("lost")
    driving.until_mode("fault")
    time.sleep(1)
    assert not driving.commands(time.time_ns() - 500 * MS), "nothing leaves meanwhile"
    plugged_ns = time.time_ns()
    adapter.plug()
    first_ms = first_frames_ms(driving, plugged_ns)
    assert is_up(VEHICLE)
    assert driving.mode() == "fault"
    assert link(GATEWAY)["txqlen"] == 4
    assert driving.told_ms("link_lost", pulled_ns) < RETURN_MS
    figures.append(
        f"plugged in: set up by udev and networkd, zero torque first after {first_ms:.0f} ms"
    )
    driving.until_driving()
