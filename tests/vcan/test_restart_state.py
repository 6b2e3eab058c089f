"""A latched CUT and the direction outlive the process, on a real bus."""

import json
import signal
import time

import pytest

from tests.vcan.conftest import (
    COMMANDS,
    PATIENCE_S,
    Process,
    Recorded,
    Recording,
    Stand,
    wait_until,
)
from vcu_gateway.client import Client, ClientError

QUIET = "steps:\n  - {at_s: 0, fault: silence, of: IMU}\n"
SILENT_CONTROLLERS = (
    "steps:\n  - {at_s: 0, fault: silence, of: PCU1}\n  - {at_s: 0, fault: silence, of: PCU2}\n"
)
POWER_CUT = bytes.fromhex("8c000000e02e0000")
REVERSE = 0b0001_0000


@pytest.fixture
def kept(stand: Stand) -> Stand:
    """Every gateway of the test finds what the one before left."""
    stand.runtime = stand.folder / "kept"
    return stand


def client(stand: Stand) -> Client:
    return Client(stand.socket_path, timeout_s=PATIENCE_S)


def until_mode(stand: Stand, mode: str) -> None:
    def is_in_mode() -> bool:
        try:
            with client(stand) as asked:
                return asked.why()["mode"] == mode
        except ClientError:
            return False

    wait_until(is_in_mode, mode)


def cut(stand: Stand) -> None:
    until_mode(stand, "standby")
    with client(stand) as operator:
        operator.estop()
    until_mode(stand, "fault")


def started(stand: Stand, recording: Recording, count: int = 10) -> tuple[Process, list[Recorded]]:
    """Another gateway, and its first command frames."""
    since_ns = time.time_ns()
    gateway = stand.gateway()

    def since() -> list[Recorded]:
        return [frame for frame in recording.commands() if frame.stamp_ns > since_ns]

    wait_until(lambda: len(since()) >= count, f"command frames; the gateway: {gateway.err}")
    return gateway, since()[:count]


def ended(gateway: Process, number: int) -> None:
    gateway.popen.send_signal(number)
    gateway.popen.wait(PATIENCE_S)
    time.sleep(0.2)  # until the recorder has all of its frames


@pytest.mark.parametrize(
    "number", [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.ci)]
)
def test_a_latched_cut_is_in_the_first_frame_of_the_next_gateway_until_a_service_reset(
    kept: Stand, number: int
):
    recording = kept.record()
    kept.vehicle(QUIET)
    gateway, _ = started(kept, recording)
    cut(kept)
    ended(gateway, number)
    gateway, first = started(kept, recording)
    assert {frame.data for frame in first} == {POWER_CUT}
    assert gateway.has_logged("cut_kept")

    def reset() -> bool:
        with client(kept) as operator:
            try:
                operator.reset("service")
            except ClientError:
                return False
        return True

    wait_until(reset, "the reset at service level")
    wait_until(lambda: recording.commands()[-1].data != POWER_CUT, "the power again")
    ended(gateway, signal.SIGKILL)
    _, first = started(kept, recording)
    assert not any(frame.data[0] & 0x80 for frame in first)


@pytest.mark.ci
def test_the_applied_direction_is_kept_where_the_controllers_are_silent(kept: Stand):
    recording = kept.record()
    vehicle = kept.vehicle(QUIET)
    gateway, _ = started(kept, recording)
    until_mode(kept, "standby")
    with client(kept) as asked, asked.demand("driver", ttl_ms=1000, hold_s=None) as owner:
        owner.set(motor_reverse=True)
        # It is kept after the tick that applied it: some ticks more have it for sure.
        recording.wait_for(
            lambda frames: all(
                f.data[0] & REVERSE for f in [f for f in frames if f.can_id in COMMANDS][-8:]
            ),
            "reverse on the bus for a while",
        )
        ended(gateway, signal.SIGKILL)
    vehicle.stop()
    kept.vehicle(SILENT_CONTROLLERS)
    gateway, first = started(kept, recording)
    assert all(frame.data[0] & REVERSE for frame in first)
    assert not any(frame.data[1] for frame in first)
    ended(gateway, signal.SIGTERM)
    _, first = started(kept, recording)
    assert all(frame.data[0] & REVERSE for frame in first), "an orderly end keeps it, too"


@pytest.mark.ci
def test_a_damaged_file_is_a_latched_cut(kept: Stand):
    recording = kept.record()
    kept.vehicle(QUIET)
    gateway, _ = started(kept, recording)
    cut(kept)
    ended(gateway, signal.SIGTERM)
    assert kept.runtime is not None
    (path,) = kept.runtime.glob("restart-vcan0-*")
    boot, text = path.read_text().splitlines()
    assert json.loads(text)["cut"]
    path.write_text(f"{boot}\n{text[:9]}")
    _, first = started(kept, recording)
    assert {frame.data for frame in first} == {POWER_CUT}
    until_mode(kept, "fault")
    with client(kept) as asked:
        assert "is not understood" in json.dumps(asked.why())
