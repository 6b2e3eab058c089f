"""Traffic in, state, two command frames out every 50 ms, on a real SocketCAN bus."""

import itertools
import json
import signal
import socket
import statistics
import struct
import subprocess
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.vcan.conftest import (
    CHANNEL,
    COMMANDS,
    Recorded,
    Stand,
    ended_after,
    ip,
    program,
    wait_until,
)

LOGS = Path(__file__).parents[1] / "logs"
MS = 1_000_000
PERIOD_NS = 50 * MS
ZERO_TORQUE = bytes.fromhex("0c000000e02e0000")
BENCH = """
bench:
  auto_arm: true
  demand: {bench_use_only: true, throttle_pct: 100, power_mode: normal, speed_limit_rpm: 3000}
"""
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


class Replayed(NamedTuple):
    """One run of the gateway with the nominal recording replayed to it."""

    commands: list[Recorded]
    state: dict[str, Any]
    opened: dict[str, Any]
    ended: dict[str, Any]


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Replayed]:
    with ended_after(Stand(tmp_path_factory.mktemp("replayed"))) as stand:
        recording = stand.record()
        state_path = stand.folder / "state.json"
        gateway = stand.gateway("", "--state-out", str(state_path))
        recording.wait_for(lambda frames: len(frames) >= 2, "the first command frames")
        replay = stand.replay(LOGS / "nominal.log")
        assert replay.popen.wait(30) == 0
        sent = int(replay.out.read_text())
        recording.wait_for(
            lambda frames: len([f for f in frames if f.can_id not in COMMANDS]) >= sent,
            "the end of the replay",
        )
        assert gateway.stop() == 0
        state = json.loads(state_path.read_text())
        opened, ended = gateway.logged("link_open"), gateway.logged("stopped")
        yield Replayed(recording.commands(), state, opened, ended)


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
    assert state["bus"]["dropped"] == 0
    assert state["bus"]["receiver_bugs"] == 0


def test_every_tick_sends_zero_torque_to_pcu1_and_then_pcu2(replayed: Replayed):
    commands, unsent = replayed.commands, replayed.ended["unsent_frames"]
    assert len(commands) >= 80
    if not unsent:
        assert [frame.can_id for frame in commands] == list(COMMANDS) * (len(commands) // 2)
    assert set(unsent) <= {"late"}, "a stall of the lab and nothing else"
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
        assert statistics.median(gaps) == pytest.approx(PERIOD_NS, rel=0.02)
        assert 0 <= ended["ticks"] - ended["silent_ticks"] - len(stamps) <= unsent


def test_it_listens_for_a_second_before_it_talks(replayed: Replayed):
    opened = datetime.fromisoformat(replayed.opened["timestamp"])
    silence_s = replayed.commands[0].stamp_ns / 1e9 - opened.timestamp()
    # The log's stamp is taken a moment after the opening.
    assert 0.99 <= silence_s <= 1.1 + 0.05 * replayed.ended["skipped"]


def test_every_tick_is_accounted_for(fresh_stand: Stand):
    gateway = fresh_stand.gateway("", "--duration", "3")
    assert gateway.popen.wait(20) == 0
    ended = gateway.logged("stopped")
    assert ended["ticks"] + ended["skipped"] == 60 + 3, "three safe frames end it"
    unsent = sum(ended["unsent_frames"].values())
    assert ended["sent_frames"] + unsent == 2 * (ended["ticks"] - ended["silent_ticks"])
    assert set(ended["unsent_frames"]) <= {"late"}, "a stall of the lab and nothing else"


def test_a_bench_demand_rises_to_full_throttle_and_does_not_wrap(stand: Stand):
    recording = stand.record()
    gateway = stand.gateway(BENCH)
    vehicle = stand.start("vehicle", *program("simulate", "--channel", CHANNEL))

    def at_full_throttle(frames: list[Recorded]) -> bool:
        assert not gateway.has_logged("fault_latched"), gateway.err.read_text()
        return BENCH_FRAME in {frame.data for frame in of(frames[-40:], COMMANDS[1])}

    recording.wait_for(at_full_throttle, "full throttle")
    assert gateway.stop() == 0
    vehicle.stop()
    throttles = [frame.data[1] for frame in of(recording.commands(), COMMANDS[0])]
    rises = [after - before for before, after in itertools.pairwise(throttles)]
    assert max(throttles) == 255
    assert max(rises) <= 13, "100 %/s is 5 % a tick, 12.8 bits"
    assert throttles[-3:] == [0, 0, 0], "three safe frames end it"


def test_both_priorities_and_the_alias_are_received_and_nothing_else(stand: Stand):
    state_path = stand.folder / "state.json"
    recording = stand.record()
    gateway = stand.gateway("", "--state-out", str(state_path))
    recording.wait_for(lambda frames: len(frames) >= 2, "the first command frames")
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
    recording.wait_for(lambda frames: len(of(frames, 0x040BD079)) == 1, "the last frame")
    recording.wait_for(lambda frames: len(frames) > 30, "ticks after it")
    assert gateway.stop() == 0
    state = json.loads(state_path.read_text())
    counts = {name: m["frame_count"] for name, m in state["messages"].items() if m["frame_count"]}
    assert counts == {"IMU_Acceleration": 2, "IMU_Attitude": 1}
    rejected = {reason: n for reason, n in state["counters"]["rejected"].items() if n}
    assert rejected == {"short": 1}, "the kernel's filters keep the others away"


def test_without_kernel_filters_the_others_are_counted_by_reason(stand: Stand):
    state_path = stand.folder / "state.json"
    recording = stand.record()
    config = "freshness: {}\n"
    path = stand.folder / "open.yaml"
    path.write_text(f"bus: {{channel: {CHANNEL}, kernel_filters: false}}\n{config}")
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
    recording.wait_for(lambda frames: len(frames) > 30, "ticks after it")
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


def test_own_frames_are_confirmed_by_the_kernels_echo_and_told_from_foreign_ones(stand: Stand):
    state_path = stand.folder / "state.json"
    recording = stand.record()
    gateway = stand.gateway("", "--state-out", str(state_path))
    recording.wait_for(lambda frames: len(frames) >= 20, "command frames")
    send((EFF | COMMANDS[0], ZERO_TORQUE))
    count = len(recording.frames())
    recording.wait_for(lambda frames: len(frames) > count + 8, "ticks after it")
    assert gateway.stop() == 0
    state = json.loads(state_path.read_text())
    assert state["counters"]["foreign_commands"] == {"PCU1": 1, "PCU2": 0}
    ticks = state["ticks"]["done"] - state["ticks"]["silent"]
    for count in state["counters"]["confirmed"].values():
        assert ticks - 1 <= count <= ticks, "the echo of the last tick may come after the end"


def test_the_simulated_vehicle_answers_every_command_with_status2(stand: Stand):
    recording = stand.record()
    gateway = stand.gateway(BENCH)
    vehicle = stand.start("vehicle", *program("simulate", "--channel", CHANNEL, "--duration", "7"))
    assert vehicle.popen.wait(30) == 0
    assert gateway.stop() == 0
    frames = recording.frames()
    answers = of(frames, 0x0809D0A7)
    begin, end = answers[0].stamp_ns, answers[-1].stamp_ns
    commands = [f for f in of(frames, COMMANDS[0]) if begin - PERIOD_NS <= f.stamp_ns <= end]
    assert abs(len(commands) - len(answers)) <= 1
    speeds = [int.from_bytes(frame.data[6:8], "little") for frame in answers]
    assert speeds[-1] > speeds[0] + 100, "full throttle moves it"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_within_a_second_with_exit_code_0(fresh_stand: Stand, number: int):
    recording = fresh_stand.record()
    gateway = fresh_stand.gateway()
    recording.wait_for(lambda frames: len(frames) >= 4, "command frames")
    assert gateway.stop(number) == 0
    assert gateway.logged("stopped")["reason"] == signal.Signals(number).name


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


def test_a_missing_interface_is_waited_for(stand: Stand):
    path = stand.folder / "other.yaml"
    path.write_text("bus: {channel: vcan9}\n")
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
    assert vehicle.popen.wait(30) == 0
    decoded = subprocess.run(
        program("decode", str(log)), capture_output=True, check=True, text=True
    )
    messages = {json.loads(line)["message"] for line in decoded.stdout.splitlines()}
    assert {"IMU_Acceleration", "BMS_Status", "PCU2_Status1"} <= messages
