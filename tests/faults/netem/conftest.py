"""A vcan0 whose frames pass the traffic control before anybody receives them."""

import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.faults.driving import BusStand
from tests.vcan.conftest import ended_after

IFF_ECHO = 0x4_0000


def _tc(*arguments: str) -> None:
    sudo = [] if os.geteuid() == 0 else ["sudo"]
    subprocess.run([*sudo, "tc", *arguments], check=True, capture_output=True)


@pytest.fixture
def disturb() -> Iterator[Callable[[str], None]]:
    """disturb("netem loss 30%"): from then on; it ends with the test."""
    flags = int(Path("/sys/class/net/vcan0/flags").read_text(), 16)
    if not flags & IFF_ECHO:
        why = "vcan0 echoes before the traffic control; load it with echo=1, as in the lab"
        if os.environ.get("CI") or os.environ.get("VCU_REQUIRE_CAN"):
            pytest.exit(why, returncode=1)
        pytest.skip(why)
    yield lambda how: _tc("qdisc", "replace", "dev", "vcan0", "root", *how.split())
    subprocess.run(["tc", "qdisc", "del", "dev", "vcan0", "root"], capture_output=True)


@pytest.fixture
def alone(tmp_path: Path) -> Iterator[BusStand]:
    with ended_after(BusStand(tmp_path, forking=True)) as stand:
        yield stand
