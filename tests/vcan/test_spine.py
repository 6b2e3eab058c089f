"""Traffic in, state, two command frames out every 50 ms, on a real SocketCAN bus."""

import itertools
import json
import signal
import socket
import statistics
import struct
import subprocess
import time
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.vcan.conftest import (
    CHANNEL,
    COMMANDS,
    PATIENCE_S,
    Process,
    Recorded,
    Recording,
    Stand,
    ended_after,
    ip,
    program,
    wait_until,
)
from vcu_gateway.client import Client

LOGS = Path(__file__).parents[1] / "logs"
MS = 1_000_000
PERIOD_NS = 50 * MS
ZERO_TORQUE = bytes.fromhex("0c000000e02e0000")
BENCH = """
bench:
  auto_arm: true
  demand: {bench_use_only: true, throttle_pct: 100, power_mode: normal, speed_limit_rpm: 3000}
"""
PCU1_STATUS2 = 0x0809D0A7
BENCH_FRAME = bytes.fromhex("04ff0000b80b60ea")
EFF = 0x8000_0000


def send(*frames: tuple[int, bytes]) -> None:
    """Frames as they are, flags included, from another socket."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        bus.bind((CHANNEL,))
        for can_id, data in frames:
            bus.send(struct.pack("=IB3x8s", can_id, len(data), data))


def of(frames: list[Recorded], can_id: int) -> list[Recorded]:
    return [frame for frame in frames if frame.can_id == can_id]


def told_full(gateway: Process) -> dict[str, Any]:
    """What an ended gateway did in all; every frame that it did not send was late."""
    ended: dict[str, Any] = gateway.logged("stopped")
    assert set(ended["unsent_frames"]) <= {"late"}, "a stall of the lab and nothing else"
    return ended


def until_commands(recording: Recording, count: int, since_ns: int | None = None) -> list[Recorded]:
    """So many command frames since then, or from now on: the recorder may lag behind."""
    from_ns = time.time_ns() if since_ns is None else since_ns
    found: list[Recorded] = []

    def are_there() -> bool:
        found[:] = [frame for frame in recording.commands() if frame.stamp_ns > from_ns]
        return len(found) >= count

    wait_until(are_there, f"{count} command frames")
    return found


class Replayed(NamedTuple):
    """One run of the gateway with the nominal recording replayed to it."""

    commands: list[Recorded]
    state: dict[str, Any]
    opened: dict[str, Any]
    ended: dict[str, Any]


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Replayed:
    with ended_after(Stand(tmp_path_factory.mktemp("replayed"), forking=True)) as stand:
        recording = stand.record()
        state_path = stand.folder / "state.json"
        gateway = stand.gateway("", "--state-out", str(state_path))
        recording.wait_for(lambda frames: len(frames) >= 2, "the first command frames")
        replay = stand.replay(LOGS / "nominal.log")
        assert replay.popen.wait(PATIENCE_S) == 0
        sent = int(replay.out.read_text())
        recording.wait_for(
            lambda frames: len([f for f in frames if f.can_id not in COMMANDS]) >= sent,
            "the end of the replay",
        )
        assert gateway.stop() == 0
        state = json.loads(state_path.read_text())
        opened, ended = gateway.logged("link_open"), told_full(gateway)
        commands = until_commands(recording, ended["sent_frames"], since_ns=0)
    return Replayed(commands, state, opened, ended)


def test_recorded_traffic_reaches_the_store_as_the_oracle_decodes_it(replayed: Replayed):
    state = replayed.state
    expected = json.loads((LOGS / "nominal.expected.json").read_text())
    assert set(state["messages"]) == set(expected)
    for message, wanted in expected.items():
        found = state["messages"][message]
        assert found["frame_count"] == wanted["count"], message
        assert found["marked_count"] == 0, message
        for signal_name, value in wanted["values"].items():
            reading = found["signals"][signal_name]
            assert reading["value"] == pytest.approx(value), (message, signal_name)
            assert reading["raw"] == wanted["raws"][signal_name], (message, signal_name)
    assert sum(state["counters"]["rejected"].values()) == 0
    assert sum(state["counters"]["foreign_commands"].values()) == 0
    own_echoes = sum(state["counters"]["confirmed"].values())
    assert state["bus"]["dropped"] == state["bus"]["sent"] - own_echoes, "the last echoes at most"
    assert state["bus"]["receiver_bugs"] == 0


def test_every_tick_sends_zero_torque_to_pcu1_and_then_pcu2(replayed: Replayed):
    commands, unsent = replayed.commands, replayed.ended["unsent_frames"]
    assert len(commands) >= 80
    if not unsent:
        assert [frame.can_id for frame in commands] == list(COMMANDS) * (len(commands) // 2)
    assert {frame.data for frame in commands} == {ZERO_TORQUE}


def test_the_cadence_is_50_ms_without_drift_and_never_a_burst(replayed: Replayed):
    ended = replayed.ended
    for can_id in COMMANDS:
        stamps = [frame.stamp_ns for frame in of(replayed.commands, can_id)]
        gaps = [later - earlier for earlier, later in itertools.pairwise(stamps)]
        assert min(gaps) >= PERIOD_NS // 2, "two frames closer than half a period"
        # A stall of the machine may skip a point of the grid; it must not move the grid.
        points = [round(gap / PERIOD_NS) for gap in gaps]
        drift_ns = stamps[-1] - stamps[0] - sum(points) * PERIOD_NS
        assert abs(drift_ns) < PERIOD_NS // 2
        unsent = sum(ended["unsent_frames"].values())
        assert sum(points) - len(points) <= ended["skipped"] + unsent
        assert statistics.median(gaps) == pytest.approx(PERIOD_NS, rel=0.2)
        assert 0 <= ended["ticks"] - ended["silent_ticks"] - len(stamps) <= unsent


def test_it_listens_for_a_second_before_it_talks(replayed: Replayed):
    opened = datetime.fromisoformat(replayed.opened["timestamp"])
    silence_s = replayed.commands[0].stamp_ns / 1e9 - opened.timestamp()
    ended = replayed.ended
    missed = ended["skipped"] + sum(ended["unsent_frames"].values())
    # The log's stamp is taken a moment after the opening, and the machine may stall between.
    assert 0.9 <= silence_s <= 1.1 + 0.05 * missed
    assert ended["silent_ticks"] + ended["skipped"] >= 20, "50 ms each, from the opening on"


def test_every_tick_is_accounted_for(stand: Stand):
    gateway = stand.gateway("", "--duration", "3")
    assert gateway.popen.wait(PATIENCE_S) == 0
    ended = told_full(gateway)
    unsent = sum(ended["unsent_frames"].values())
    # Three safe frames end it; what the lab's stalls cost of them is made up for.
    made_up = ended["ticks"] + ended["skipped"] - (60 + 3)
    assert 0 <= made_up <= ended["skipped"] + unsent
    assert ended["sent_frames"] + unsent == 2 * (ended["ticks"] - ended["silent_ticks"])


def driven_to_the_full(stand: Stand, recording: Recording) -> list[Recorded] | None:
    """The commands of a gateway until full throttle and its end; None where a stall stopped it."""
    begun_ns = time.time_ns()
    gateway = stand.gateway(BENCH)

    def latched_or_at_full_throttle() -> bool:
        last = [f.data for f in recording.commands() if f.stamp_ns > begun_ns][-4:]
        return BENCH_FRAME in last or gateway.has_logged("fault_latched")

    wait_until(latched_or_at_full_throttle, "full throttle")
    latched = gateway.has_logged("fault_latched")
    assert gateway.stop() == 0
    if latched:
        assert gateway.has_logged("ticks_skipped"), gateway.err.read_text()
        return None
    return until_commands(recording, told_full(gateway)["sent_frames"], begun_ns)


class FullThrottle(NamedTuple):
    """One drive to full throttle and its end, and what the vehicle answered before and in it."""

    commands: list[Recorded]
    answers: list[Recorded]
    sent: int


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> FullThrottle:
    with ended_after(Stand(tmp_path_factory.mktemp("full"), forking=True)) as stand:
        recording = stand.record()
        vehicle = stand.vehicle()
        recording.wait_for(lambda frames: len(frames) > 0, "the vehicle: it hears every command")
        tries = (driven_to_the_full(stand, recording) for _ in range(4))
        commands = next(found for found in tries if found is not None)
        assert vehicle.stop() == 0
        sent = len(of(recording.commands(), COMMANDS[0]))
        recording.wait_for(lambda frames: len(of(frames, PCU1_STATUS2)) >= sent - 1, "the answers")
        answers = of(recording.frames(), PCU1_STATUS2)
    return FullThrottle(commands, answers, sent)


def test_a_bench_demand_rises_to_full_throttle_and_does_not_wrap(full: FullThrottle):
    throttles = [frame.data[1] for frame in of(full.commands, COMMANDS[0])]
    rises = [after - before for before, after in itertools.pairwise(throttles)]
    assert max(throttles) == 255
    assert max(rises) <= 13, "100 %/s is 5 % a tick, 12.8 bits"
    assert throttles[-3:] == [0, 0, 0], "three safe frames end it"


def test_the_simulated_vehicle_answers_every_command_with_status2(full: FullThrottle):
    assert full.sent - 1 <= len(full.answers) <= full.sent
    speeds = [int.from_bytes(frame.data[6:8], "little") for frame in full.answers]
    assert max(speeds) > speeds[0] + 100, "full throttle moves it"


@pytest.mark.ci
def test_without_kernel_filters_the_others_are_counted_by_reason(stand: Stand):
    state_path = stand.folder / "state.json"
    recording = stand.record()
    path = stand.folder / "open.yaml"
    api = f"api: {{socket_path: {stand.socket_path}}}"
    path.write_text(f"bus: {{channel: {CHANNEL}, kernel_filters: false}}\n{api}\n")
    gateway = stand.start(
        "gateway", *program("run", "-c", str(path), "--state-out", str(state_path))
    )
    recording.wait_for(lambda frames: len(frames) >= 2, "the first command frames")
    payload = bytes(8)
    send(
        (EFF | 0x18FECA15, payload),
        (EFF | 0x040AD07A, payload),
        (0x079, payload),
        (EFF | 0x4000_0000 | 0x040AD079, payload),  # remote
        (0x2000_0000 | 0x40, payload),  # error frame: bus-off
        (EFF | 0x040BD079, payload[:3]),
    )
    recording.wait_for(lambda frames: len(of(frames, 0x040BD079)) == 1, "the last frame")
    until_commands(recording, 20)
    assert gateway.stop() == 0
    rejected = json.loads(state_path.read_text())["counters"]["rejected"]
    assert rejected == {
        "error": 1,
        "remote": 1,
        "standard_id": 1,
        "unknown": 1,
        "foreign_source": 1,
        "short": 1,
        "long": 0,
    }


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.ci)]
)
def test_a_signal_ends_it_within_a_second_with_exit_code_0(fresh_stand: Stand, number: int):
    recording = fresh_stand.record()
    gateway = fresh_stand.gateway()
    recording.wait_for(lambda frames: len(frames) >= 4, "command frames")
    assert gateway.stop(number) == 0
    assert gateway.logged("stopped")["reason"] == signal.Signals(number).name


@pytest.mark.ci
def test_an_interface_deleted_and_made_again_is_opened_again(stand: Stand):
    recording = stand.record()
    gateway = stand.gateway()
    recording.wait_for(lambda frames: len(frames) >= 4, "command frames")
    ip("link", "del", CHANNEL)
    wait_until(lambda: any(e["event"] == "link_lost" for e in gateway.log()), "the loss")
    ip("link", "add", "dev", CHANNEL, "type", "vcan")
    ip("link", "set", CHANNEL, "up")
    (stand.folder / "again").mkdir()
    with ended_after(Stand(stand.folder / "again")) as again:
        again.record().wait_for(lambda frames: len(frames) >= 4, "frames on the new interface")
    assert gateway.stop() == 0


@pytest.mark.ci
def test_a_missing_interface_is_waited_for(stand: Stand):
    path = stand.folder / "other.yaml"
    path.write_text(f"bus: {{channel: vcan9}}\napi: {{socket_path: {stand.socket_path}}}\n")
    gateway = stand.start("gateway", *program("run", "-c", str(path)))
    wait_until(lambda: any(e["event"] == "link_unavailable" for e in gateway.log()), "the word")
    assert "ip link add dev vcan9" in str(gateway.logged("link_unavailable")["reason"])
    ip("link", "add", "dev", "vcan9", "type", "vcan")
    try:
        ip("link", "set", "vcan9", "up")
        wait_until(lambda: any(e["event"] == "link_open" for e in gateway.log()), "the opening")
        assert gateway.stop() == 0
    finally:
        ip("link", "del", "vcan9")


def test_decode_reads_what_candump_style_recording_the_simulator_wrote(stand: Stand):
    log = stand.folder / "vehicle.log"
    vehicle = stand.start(
        "vehicle", *program("simulate", "--channel", CHANNEL, "--duration", "2", "--log", str(log))
    )
    assert vehicle.popen.wait(PATIENCE_S) == 0
    decoded = subprocess.run(
        program("decode", str(log)), capture_output=True, check=True, text=True
    )
    messages = {json.loads(line)["message"] for line in decoded.stdout.splitlines()}
    assert {"IMU_Acceleration", "BMS_Status", "PCU2_Status1"} <= messages


# One gateway for the rest, which look at what it counts.


class Running(NamedTuple):
    """A gateway that runs, and the recording of the bus."""

    gateway: Process
    recording: Recording
    client: Client

    def counts(self) -> dict[str, Any]:
        """Frames of each message, and the counters of frames and ticks, by now."""
        messages = self.client.state()["messages"].items()
        health = self.client.health()
        return {
            "messages": {name: message["frame_count"] for name, message in messages},
            **health["frames"],
            "ticks": health["ticks"],
        }


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    with ended_after(Stand(tmp_path_factory.mktemp("running"), forking=True)) as stand:
        recording = stand.record()
        gateway = stand.gateway()
        recording.wait_for(lambda frames: len(frames) >= 2, "the first command frames")
        with Client(stand.socket_path, timeout_s=PATIENCE_S) as client:
            yield Running(gateway, recording, client)


def more(before: dict[str, int], after: dict[str, int]) -> dict[str, int]:
    """What has grown, and by how much."""
    grown = {name: count - before.get(name, 0) for name, count in after.items()}
    return {name: count for name, count in grown.items() if count}


def test_both_priorities_and_the_alias_are_received_and_nothing_else(running: Running):
    before = running.counts()
    payload = bytes.fromhex("a81ea81ea81e0000")
    send(
        (EFF | 0x040AD079, payload),
        (EFF | 0x1C0AD079, payload),
        (EFF | 0x08F02DE2, bytes(8)),
        (EFF | 0x18FECA15, payload),  # unknown
        (EFF | 0x040AD07A, payload),  # another source
        (0x079, payload),  # 11 bits, equal in the low ones
        (EFF | 0x040BD079, payload[:7]),  # short
    )
    running.recording.wait_for(lambda frames: len(of(frames, 0x040BD079)) == 1, "the last frame")
    until_commands(running.recording, 20)
    after = running.counts()
    received = more(before["messages"], after["messages"])
    assert received == {"IMU_Acceleration": 2, "IMU_Attitude": 1}
    rejected = more(before["rejected"], after["rejected"])
    assert rejected == {"short": 1}, "the kernel's filters keep the others away"


def test_own_frames_are_confirmed_by_the_kernels_echo_and_told_from_foreign_ones(running: Running):
    until_commands(running.recording, 20)
    before = running.counts()
    send((EFF | COMMANDS[0], ZERO_TORQUE))
    until_commands(running.recording, 8)
    after = running.counts()
    foreign = more(before["foreign_commands"], after["foreign_commands"])
    assert foreign == {"PCU1": 1}
    ticks = after["ticks"]["done"] - after["ticks"]["silent"]
    unsent = sum(after["unsent"].values())
    for count in after["confirmed"].values():
        # The echo of the last tick may not have been read yet.
        assert ticks - unsent - 1 <= count <= ticks


def test_a_command_of_any_source_and_one_to_all_pass_the_kernels_filters_once(running: Running):
    before = running.counts()
    foreign = (COMMANDS[0], 0x0008A755, 0x1C08A8A7, 0x0008FF55)
    send(*((EFF | can_id, ZERO_TORQUE) for can_id in foreign))
    send(*((EFF | can_id, ZERO_TORQUE) for can_id in (0x0008A655, 0x0009A755, 0x0008FE55)))
    send((0x755, ZERO_TORQUE))
    until_commands(running.recording, 8)
    after = running.counts()
    counted = more(before["foreign_commands"], after["foreign_commands"])
    assert counted == {"PCU1": 3, "PCU2": 2}
