"""The files for systemd-networkd, put in effect as docs/install.md says, on a real networkd."""

import contextlib
import json
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.faults.slcan.adapter import Adapter
from tests.service.unit import PATIENCE_S, systemctl
from tests.vcan.conftest import wait_until
from vcu_gateway.bus import netlink

pytestmark = pytest.mark.ci

SHIPPED = Path("/usr/share/vcu-gateway/network")
IN_EFFECT = Path("/etc/systemd/network")

Copy = Callable[..., None]


@pytest.fixture
def copy() -> Iterator[Copy]:
    """Copies a file for another interface than the one it names; gone afterwards."""
    made: list[Path] = []

    def copied(name: str, named: str, instead: str, without: str = "\n\n") -> None:
        text = (SHIPPED / name).read_text().replace(named, instead).replace(without, "\n")
        made.append(IN_EFFECT / name.replace(named, instead))
        made[-1].write_text(text)

    yield copied
    systemctl("stop", "systemd-networkd.socket", "systemd-networkd.service")
    for path in made:
        path.unlink()


def networkd() -> None:
    subprocess.run(["udevadm", "control", "--reload"], check=True)
    done = systemctl("restart", "systemd-networkd")
    assert done.returncode == 0, done.stderr


def link(name: str) -> dict[str, Any]:
    """As `ip` sees it; {} where there is none."""
    done = subprocess.run(
        ["ip", "-details", "-json", "link", "show", name], capture_output=True, text=True
    )
    return json.loads(done.stdout)[0] if done.returncode == 0 else {}


def is_up(name: str) -> bool:
    return "UP" in link(name).get("flags", [])


def test_the_bench_gets_its_virtual_bus(copy: Copy):
    copy("vcan0.netdev", "vcan0", "vcan7")
    copy("vcan0.network", "vcan0", "vcan7")
    networkd()
    wait_until(lambda: is_up("vcan7"), "vcan7 to be up", PATIENCE_S)
    assert link("vcan7")["linkinfo"]["info_kind"] == "vcan"
    subprocess.run(["ip", "link", "delete", "vcan7"], check=True)


def test_an_interface_that_appears_gets_a_short_queue_whatever_the_other_link_files_say(
    copy: Copy,
):
    copy("10-can0.link", "can0", "can8")
    subprocess.run(["udevadm", "control", "--reload"], check=True)
    subprocess.run(["ip", "link", "add", "dev", "can8", "type", "vcan"], check=True)
    try:
        wait_until(lambda: link("can8")["txqlen"] == 4, "a queue of 4 frames", PATIENCE_S)
    finally:
        subprocess.run(["ip", "link", "delete", "can8"], check=True)


@pytest.mark.skipif(not Path("/sys/module/slcan").exists(), reason="slcan is not loaded")
def test_an_adapter_gets_its_bit_rate_and_is_up(copy: Copy):
    with contextlib.closing(Adapter()) as adapter:
        # The kernel's slcan knows no restart; real controllers do.
        copy("can0.network", "can0", adapter.name, without="\nRestartSec=100ms\n")
        networkd()
        wait_until(lambda: is_up(adapter.name), f"{adapter.name} to be up", PATIENCE_S)
        assert netlink.details(adapter.name).bit_rate_bit_s == 250_000
