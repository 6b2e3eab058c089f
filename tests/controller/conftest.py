"""Two CAN controllers on one bus: the gateway's, can0, and that of vehicle and recorder, can1."""

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.faults.driving import BusStand, Driving
from tests.vcan.conftest import (
    Stand,
    ended_after,
    figures,  # noqa: F401 - a fixture
    ip,
    pytest_terminal_summary,  # noqa: F401 - a hook of pytest
)

GATEWAY, VEHICLE = "can0", "can1"
SETTING = ("bitrate", "250000", "restart-ms", "100")
# As they are after the driver has made the interface, but for the bit rate.
PLAIN = (
    *("loopback", "off", "listen-only", "off", "one-shot", "off", "berr-reporting", "off"),
    *("triple-sampling", "off", "presume-ack", "off"),
)


def controllers_are_missing() -> str | None:
    """Why these tests cannot run here, or None."""
    if os.environ.get("VCU_LAB") not in ("qemu", "systemd"):
        return "needs a machine to throw away: `make test-controller` boots one in the lab"
    if missing := [name for name in (GATEWAY, VEHICLE) if not device(name).exists()]:
        return f"no controller {' and '.join(missing)}: run it by `lab run --qemu`"
    return None


def device(name: str) -> Path:
    """The controller behind an interface, in sysfs; a virtual one has none."""
    return Path("/sys/class/net", name, "device")


@pytest.fixture(scope="session", autouse=True)
def two_controllers() -> None:
    subprocess.run(["udevadm", "settle"], capture_output=True, check=False)
    why = controllers_are_missing()
    if why and (os.environ.get("CI") or os.environ.get("VCU_REQUIRE_CONTROLLER")):
        pytest.exit(why, returncode=1)
    if why:
        pytest.skip(why)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """An emulated machine on a busy one takes its time."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.timeout(600), append=False)


def link(name: str) -> dict[str, Any]:
    """As `ip` sees it, with its statistics; {} where there is none."""
    command = ["ip", "-details", "-statistics", "-json", "link", "show", name]
    done = subprocess.run(command, capture_output=True, text=True)
    return json.loads(done.stdout)[0] if done.returncode == 0 else {}


def set_link(name: str, *setting: str, queue_frames: int = 4) -> None:
    """Set an interface up with these words of ip's for its controller; all else is plain."""
    ip("link", "set", name, "down")
    ip("link", "set", name, "txqueuelen", str(queue_frames))
    ip("link", "set", name, "type", "can", *SETTING, *PLAIN)
    if setting:
        ip("link", "set", name, "type", "can", *setting)
    ip("link", "set", name, "up")


@pytest.fixture
def bus(two_controllers: None) -> None:
    """Both interfaces, up and set as the vehicle's computer has them."""
    for name in (VEHICLE, GATEWAY):
        set_link(name)


@pytest.fixture
def stand_in(bus: None) -> Callable[[Path], Stand]:
    """Makes stands on this bus."""
    return lambda folder: Stand(folder, channel=GATEWAY, wire=VEHICLE, forking=True)


@pytest.fixture
def stand(stand_in: Callable[[Path], Stand], tmp_path: Path) -> Iterator[Stand]:
    with ended_after(stand_in(tmp_path)) as one:
        yield one


@pytest.fixture
def driving(bus: None, tmp_path: Path) -> Iterator[Driving]:
    """With throttle on the bus; the invariants are held against it afterwards."""
    with ended_after(BusStand(tmp_path, channel=GATEWAY, forking=True)) as stand:
        one = Driving(stand, wire=VEHICLE)
        try:
            one.start_vehicle()
            one.until_driving()
            yield one
            one.check()
        finally:
            one.let_go()
