"""What the service may do to the machine, tried by a process of its own inside the sandbox."""

import json
import pwd
from pathlib import Path
from typing import Any

import pytest

from tests.service.conftest import fresh
from tests.service.unit import drop_in

pytestmark = pytest.mark.ci

PROBE = Path("/usr/local/lib/probe.py")  # where the service, too, can see it
STATE = Path("/var/lib/vcu-gateway")
REPORT = STATE / "probe.json"
OWN = {"/run/vcu-gateway", "/var/lib/vcu-gateway", "/tmp"}


@pytest.fixture(scope="module")
def probed(default_config: str) -> dict[str, Any]:
    """What the probe found; the service was up at the time."""
    PROBE.write_text(Path(__file__).with_name("probe.py").read_text())
    unit = fresh(default_config)
    with drop_in(f"[Service]\nExecStartPost=/usr/bin/python3 -I {PROBE} {REPORT}\n"):
        unit.start()
        unit.stop()
    found: dict[str, Any] = json.loads(REPORT.read_text())
    return found


def test_it_is_the_packages_user_and_its_recordings_are_nobody_elses(probed: dict[str, Any]):
    user = pwd.getpwnam("vcu-gateway")
    assert probed["uid"] == user.pw_uid
    assert (REPORT.stat().st_uid, REPORT.stat().st_mode & 0o077) == (user.pw_uid, 0)
    assert STATE.stat().st_mode & 0o007 == 0


def test_it_writes_into_its_own_folders_and_into_no_other(probed: dict[str, Any]):
    assert {folder for folder, error in probed["writes"].items() if error is None} == OWN


def test_it_sees_the_system_and_its_own_and_nothing_else(probed: dict[str, Any]):
    system = {"bin", "lib", "lib64", "sbin", "usr", "etc", "dev", "proc", "sys"}
    assert set(probed["sees"]["/"]) <= system | {"run", "tmp", "var", "home", "root"}
    assert probed["sees"]["/etc/vcu-gateway"] == ["gateway.yaml"]
    assert not [name for name in probed["sees"]["/dev"] if name.startswith(("sd", "ttyS", "mem"))]
    assert probed["processes"] <= 3, "its own alone"


def test_it_has_the_can_bus_and_no_other_network(probed: dict[str, Any]):
    assert probed["AF_CAN"] is None
    assert probed["AF_INET"] is not None


@pytest.mark.parametrize(
    "what",
    ["memory that is written and run", "a higher priority", "a file of another owner"],
)
def test_it_gets_nothing_that_it_was_not_given(probed: dict[str, Any], what: str):
    assert probed[what] is not None
