"""`vcu-gateway doctor` on a real vcan0, beside the real gateway and vehicle."""

import json
import time
from pathlib import Path

import pytest

from tests.vcan.conftest import COMMANDS, PATIENCE_S, Stand, ip, program, wait_until

# Imported for the processes that are forked from this one.
from vcu_gateway.cli import doctor  # noqa: F401
from vcu_gateway.client import Client, ClientError
from vcu_gateway.core import j1939
from vcu_gateway.protocol import dbc, packaged

BENCH = """
bench: {auto_arm: true, demand: {bench_use_only: true, throttle_pct: 20}}
limits: {speed_limit_max_rpm: 3000}
"""


def examined(stand: Stand, *options: str) -> dict[str, dict[str, str]]:
    """Findings by "subject check"; the last of those that share one."""
    command = program("doctor", "-c", str(stand.config_path), "--json", *options)
    child = stand.start("doctor", *command)
    status = child.popen.wait(PATIENCE_S)
    assert child.err.read_text() == ""
    told = json.loads(child.out.read_text())
    assert status == (0 if told["healthy"] else 1)
    return {f"{one['subject']} {one['check']}": one for one in told["findings"]}


def examined_until(stand: Stand, wanted: str, *options: str) -> dict[str, dict[str, str]]:
    """As `examined`, with this finding: a busy machine may answer the doctor too late."""
    for _ in range(4):
        found = examined(stand, *options)
        if wanted in found:
            break
    return found


def kinds(found: dict[str, dict[str, str]], subject: str) -> set[str]:
    return {one["kind"] for name, one in found.items() if name.startswith(f"{subject} ")}


def drive(stand: Stand) -> None:
    """Begin to drive; where a stall of the machine ends it before, by a further gateway."""
    gateway = stand.gateway(BENCH)
    stand.vehicle()
    for _ in range(3):
        wait_until(lambda: mode(stand.socket_path) in ("active", "fault"), "the gateway to drive")
        if mode(stand.socket_path) == "active":
            return
        assert gateway.stop() == 0
        assert gateway.has_logged("ticks_skipped"), gateway.err.read_text()
        gateway = stand.gateway(BENCH)
    pytest.fail("it never drove: the machine stalls too often")


def mode(path: Path) -> str | None:
    try:
        with Client(path) as client:
            return client.why()["mode"]
    except ClientError:
        return None


def test_a_gateway_and_its_vehicle_are_heard(stand):
    drive(stand)
    found = examined_until(stand, "gateway mode", "--listen")
    assert kinds(found, "interface") == {"ok"}
    assert found["interface well"]["what"] == "vcan0: up, vcan, no bit rate"
    assert "wrong" not in kinds(found, "bus")  # on a busy machine messages may be slow
    for word in ("VCU_PCU1_Command sent", "VCU_PCU2_Command sent"):
        assert word in found["bus well"]["what"]
    assert "gateway mode" in found
    assert found["process priority"]["kind"] == "warning"  # no service: an ordinary process


def test_looking_and_listening_change_nothing_on_the_bus(stand):
    drive(stand)
    recording = stand.record()
    recording.wait_for(lambda frames: len(frames) > 100, "traffic")
    begin_ns = time.time_ns()
    examined(stand, "--listen")
    end_ns = time.time_ns()
    recording.wait_for(lambda frames: frames[-1].stamp_ns > end_ns, "what came after")
    during = [one for one in recording.frames() if begin_ns <= one.stamp_ns <= end_ns]
    known = {j1939.match_key(message.can_id) for message in dbc.load(packaged("vcu.dbc")).messages}
    assert {j1939.match_key(frame.can_id) for frame in during} <= known
    for can_id in COMMANDS:
        count = sum(frame.can_id == can_id for frame in during)
        # The first may be half a period late.
        assert count <= (end_ns - begin_ns) / 50e6 + 1.5, "more commands than the gateway's own"
    with Client(stand.socket_path, timeout_s=PATIENCE_S) as client:
        foreign = client.health()["frames"]["foreign_commands"]
    assert not any(foreign.values()), "nobody else's commands"


def test_a_silent_bus_is_wrong_only_for_who_listens(stand):
    stand.configure("")
    assert not any(name.startswith("bus ") for name in examined(stand))
    assert examined(stand, "--listen")["bus silent"]["kind"] == "wrong"


def test_commands_without_a_gateway_are_another_sender(stand):
    drive(stand)
    stand.config_path.write_text("bus: {channel: vcan0}\napi: {socket_path: /run/none.sock}\n")
    found = examined(stand, "--listen")["bus other_sender"]
    assert found["kind"] == "wrong"


@pytest.fixture
def extra(stand):
    """An interface of the test's own."""
    stand.channel = "vcan7"
    ip("link", "add", "dev", "vcan7", "type", "vcan")
    yield stand
    ip("link", "del", "vcan7")


def test_an_interface_is_down_until_the_named_command_sets_it_up(extra):
    extra.configure("")
    found = examined(extra)["interface up"]
    assert found["kind"] == "wrong"
    assert found["remedy"] == "sudo ip link set vcan7 up"
    ip(*found["remedy"].split()[2:])
    assert kinds(examined(extra), "interface") == {"ok"}


def test_a_missing_interface_names_the_others(stand):
    stand.channel = "can3"
    stand.configure("")
    found = examined(stand)["interface exists"]
    assert found["kind"] == "wrong"
    assert "set bus.channel to vcan0" in found["remedy"]


def test_a_file_changed_since_the_start_is_told(stand):
    drive(stand)
    stand.configure(BENCH.replace("3000", "2000"))
    found = examined_until(stand, "gateway config_digest")
    assert found["gateway config_digest"]["kind"] == "warning"
