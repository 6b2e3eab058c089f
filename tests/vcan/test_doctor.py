"""`vcu-gateway doctor` on a real vcan0, beside the real gateway and vehicle."""

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.vcan.conftest import (
    COMMANDS,
    PATIENCE_S,
    Recorded,
    Stand,
    ended_after,
    ip,
    program,
    wait_until,
)

# Imported for the processes that are forked from this one.
from vcu_gateway.cli import doctor  # noqa: F401
from vcu_gateway.client import Client, ClientError
from vcu_gateway.core import j1939
from vcu_gateway.protocol import dbc, packaged

pytestmark = pytest.mark.ci

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


def test_a_silent_bus_is_wrong_only_for_who_listens(stand):
    stand.configure("")
    assert not any(name.startswith("bus ") for name in examined(stand))
    assert examined(stand, "--listen")["bus silent"]["kind"] == "wrong"


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


# One gateway drives for all who only look at it: the bus is silent before and not after.


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stand]:
    with ended_after(Stand(tmp_path_factory.mktemp("driven"), forking=True)) as stand:
        drive(stand)
        yield stand


@pytest.fixture
def driven(shared: Stand) -> Stand:
    """Drives with its configuration in the file; by a further gateway where a stall ended it."""
    shared.configure(BENCH)
    if mode(shared.socket_path) != "active":
        for child in shared.children:
            child.stop()
        drive(shared)
    return shared


@dataclass
class Heard:
    """What the doctor found while it listened, and what was on the bus meanwhile."""

    found: dict[str, dict[str, str]]
    begin_ns: int
    end_ns: int
    frames: list[Recorded]
    foreign_commands: int


@pytest.fixture(scope="module")
def heard(shared: Stand) -> Heard:
    """It listens once for both tests."""
    recording = shared.record()
    recording.wait_for(lambda frames: len(frames) > 100, "traffic")
    begin_ns = time.time_ns()
    found = examined_until(shared, "gateway mode", "--listen")
    end_ns = time.time_ns()
    recording.wait_for(lambda frames: frames[-1].stamp_ns > end_ns, "what came after")
    during = [one for one in recording.frames() if begin_ns <= one.stamp_ns <= end_ns]
    recording.process.stop()
    with Client(shared.socket_path, timeout_s=PATIENCE_S) as client:
        foreign = client.health()["frames"]["foreign_commands"]
    return Heard(found, begin_ns, end_ns, during, sum(foreign.values()))


def test_a_gateway_and_its_vehicle_are_heard(heard: Heard):
    found = heard.found
    assert kinds(found, "interface") == {"ok"}
    assert found["interface well"]["what"] == "vcan0: up, vcan, no bit rate"
    assert "wrong" not in kinds(found, "bus")  # on a busy machine messages may be slow
    for word in ("VCU_PCU1_Command sent", "VCU_PCU2_Command sent"):
        assert word in found["bus well"]["what"]
    assert "gateway mode" in found
    assert found["process priority"]["kind"] == "warning"  # no service: an ordinary process


def test_looking_and_listening_change_nothing_on_the_bus(heard: Heard):
    known = {j1939.match_key(message.can_id) for message in dbc.load(packaged("vcu.dbc")).messages}
    assert {j1939.match_key(frame.can_id) for frame in heard.frames} <= known
    for can_id in COMMANDS:
        count = sum(frame.can_id == can_id for frame in heard.frames)
        # The first may be half a period late.
        assert count <= (heard.end_ns - heard.begin_ns) / 50e6 + 1.5, (
            "more commands than the gateway's own"
        )
    assert not heard.foreign_commands, "nobody else's commands"


def test_commands_without_a_gateway_are_another_sender(driven: Stand):
    driven.config_path.write_text("bus: {channel: vcan0}\napi: {socket_path: /run/none.sock}\n")
    found = examined(driven, "--listen")["bus other_sender"]
    assert found["kind"] == "wrong"


def test_a_file_changed_since_the_start_is_told(driven: Stand):
    driven.configure(BENCH.replace("3000", "2000"))
    found = examined_until(driven, "gateway config_digest")
    assert found["gateway config_digest"]["kind"] == "warning"
