"""The real program on a multicast group instead of a CAN interface."""

import subprocess
import time
from collections.abc import Iterator

import can
import pytest

from tests.vcan.conftest import COMMANDS, PATIENCE_S, Process, Stand, ip, program, wait_until
from vcu_gateway.client import Client, ClientError

GROUP, NETWORK = "239.192.17.4", "239.192.0.0/14"
DRIVEN_S = 5.0
QUIET = "steps:\n  - {at_s: 0, fault: silence, of: IMU}\n"
BENCH = """
bench:
  auto_arm: true
  demand: {bench_use_only: true, throttle_pct: 20, power_mode: normal}
"""
ZERO_TORQUE = bytes.fromhex("0c000000e02e0000")


@pytest.fixture
def network() -> Iterator[None]:
    """The lab has no network but the loopback."""
    known = subprocess.run(["ip", "route", "get", GROUP], capture_output=True).returncode == 0
    if not known:
        ip("route", "add", NETWORK, "dev", "lo")
    yield
    if not known:
        ip("route", "del", NETWORK, "dev", "lo")


def started(stand: Stand) -> Process:
    api = f"api: {{socket_path: {stand.socket_path}}}"
    bus = f"bus: {{interface: udp_multicast, channel: {GROUP}}}"
    stand.config_path.write_text(f"{bus}\n{api}\n{BENCH}")
    scenario = stand.folder / "scenario.yaml"
    scenario.write_text(QUIET)
    options = ("--interface", "udp_multicast", "--channel", GROUP, "--scenario", str(scenario))
    stand.start("vehicle", *program("simulate", *options))
    return stand.start("gateway", *program("run", "-c", str(stand.config_path)))


@pytest.mark.ci
@pytest.mark.usefixtures("network")
def test_it_drives_among_its_own_frames_and_stops_for_those_of_another_sender(stand: Stand):
    gateway = started(stand)
    client = Client(stand.socket_path, timeout_s=PATIENCE_S)

    def mode() -> str:
        try:
            return client.why()["mode"]
        except ClientError:
            return ""

    wait_until(lambda: mode() == "active", f"active; the gateway: {gateway.err}")
    with can.Bus(interface="udp_multicast", channel=GROUP) as other:
        ended_s = time.monotonic() + DRIVEN_S
        throttles = []
        while time.monotonic() < ended_s:
            message = other.recv(1.0)
            if message is not None and message.arbitration_id in COMMANDS:
                throttles.append(message.data[1])
        assert mode() == "active", gateway.err.read_text()
        frames = client.health()["frames"]
        assert frames["foreign_commands"] == {"PCU1": 0, "PCU2": 0}
        assert min(frames["confirmed"].values()) > 80, "its own frames come back, and count"
        assert max(throttles) == 51
        assert len(throttles) > 150
        other.send(can.Message(arbitration_id=COMMANDS[1], data=ZERO_TORQUE))
        wait_until(lambda: mode() == "fault", "the stop")
    assert client.health()["frames"]["foreign_commands"] == {"PCU1": 0, "PCU2": 1}
    client.close()


@pytest.mark.usefixtures("network")
@pytest.mark.ci
def test_a_second_gateway_of_the_group_stays_silent_and_the_first_goes_on(stand: Stand):
    gateway = started(stand)
    wait_until(lambda: gateway.has_logged("mode_changed"), "the first gateway")
    path, socket = stand.folder / "second.yaml", stand.folder / "second.sock"
    bus = f"bus: {{interface: udp_multicast, channel: {GROUP}}}"
    path.write_text(f"{bus}\napi: {{socket_path: {socket}}}\n")

    def drives() -> bool:
        with Client(stand.socket_path, timeout_s=PATIENCE_S) as client:
            return client.why()["mode"] == "active"

    wait_until(drives, "active")
    second = stand.start("second", *program("run", "-c", str(path), "--duration", "5"))
    assert second.popen.wait(PATIENCE_S) == 0
    assert second.logged("stopped")["sent_frames"] == 0
    # A stall of the lab may have ended the drive; the second one has not.
    assert drives() or gateway.has_logged("ticks_skipped"), gateway.err.read_text()
    assert "foreign_sender" not in gateway.err.read_text()
