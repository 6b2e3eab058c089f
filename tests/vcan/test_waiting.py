"""What waits in the socket when a tick begins is in that tick, also after a stall."""

import os
import signal
import socket
import struct
import time
from collections.abc import Iterator

import pytest

from tests.faults.driving import Driving, driving_in, set_up
from tests.vcan.conftest import CHANNEL, COMMANDS, PATIENCE_S, wait_until

EFF = 0x8000_0000
BMS_STATUS = 0x1808D0F4
INTERNAL_FAULT = bytes.fromhex("881300005a008000")
POWER_CUT = bytes.fromhex("8c000000e02e0000")
STALL_S, CUT_AFTER_S = 0.160, 0.100


def after_the_next_battery_frame() -> None:
    """The next good one comes 500 ms later: not while the gateway stands still."""
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        wanted = struct.pack("=II", EFF | BMS_STATUS, EFF | 0x1FFF_FFFF)
        bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, wanted)
        bus.bind((CHANNEL,))
        bus.settimeout(PATIENCE_S)
        bus.recv(16)


def send_cut() -> None:
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        bus.bind((CHANNEL,))
        bus.send(struct.pack("=IB3x8s", EFF | BMS_STATUS, 8, INTERNAL_FAULT))


# Both frames of a tick leave together.
ONE_TICK_NS = 20_000_000


def stalled(one: Driving) -> list[bytes] | None:
    """The first frame of each controller after a stall with a CUT in the socket.

    None where the process was stopped between the two frames of a tick: the first one then is
    of a tick that began before the CUT came.
    """
    pid = one.gateway.popen.pid
    assert pid is not None
    after_the_next_battery_frame()
    os.kill(pid, signal.SIGSTOP)
    time.sleep(CUT_AFTER_S)
    send_cut()
    time.sleep(STALL_S - CUT_AFTER_S)
    since_ns = time.time_ns()
    os.kill(pid, signal.SIGCONT)
    wait_until(lambda: len(one.commands(since_ns)) >= 4, "frames after the stall")
    frames = one.commands(since_ns)
    first = [next(f for f in frames if f.can_id == can_id) for can_id in COMMANDS]
    apart_ns = abs(first[0].stamp_ns - first[1].stamp_ns)
    return [frame.data for frame in first] if apart_ns < ONE_TICK_NS else None


@pytest.fixture(scope="module")
def one(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driving]:
    """A gateway that each test leaves ready for a reset."""
    with driving_in(tmp_path_factory.mktemp("waiting")) as one:
        yield one


@pytest.mark.timeout(300)
@pytest.mark.parametrize("times", [3, pytest.param(10, marks=pytest.mark.ci)])
def test_the_first_frame_after_a_stall_knows_of_the_cut_that_came_meanwhile(
    one: Driving, figures: list[str], times: int
):
    first: list[list[bytes]] = []
    while len(first) < times:
        one.until_driving()
        if (frames := stalled(one)) is not None:
            first.append(frames)
    cut = sum(frames == [POWER_CUT, POWER_CUT] for frames in first)
    torque = sum(any(frame[1] for frame in frames) for frames in first)
    figures.append(
        f"stall of {STALL_S * 1000:.0f} ms with a CUT in the socket: the first frames were"
        f" POWER_CUT {cut} of {times} times, with torque {torque} times"
    )
    assert (cut, torque) == (times, 0), first


def test_a_cut_that_came_before_the_interface_went_down_is_latched(one: Driving):
    one.until_driving()
    before = len(one.events("fault_latched"))
    after_the_next_battery_frame()
    pid = one.gateway.popen.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    try:
        send_cut()
        set_up(CHANNEL, up=False)
    finally:
        os.kill(pid, signal.SIGCONT)
    wait_until(lambda: bool(one.events("link_lost")), "the loss of the link")
    wait_until(lambda: one.mode() == "fault", "the latch")
    latched = [event["fault_class"] for event in one.events("fault_latched")[before:]]
    set_up(CHANNEL, up=True)
    assert "service" in latched
