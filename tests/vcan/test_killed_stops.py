"""`kill -9` around an emergency stop: what was answered, or was on the bus, is latched ever after.

A bench demand arms itself and drives where nothing is latched: a latch that is lost would drive.
"""

import contextlib
import json
import random
import signal
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.vcan.conftest import CHANNEL, COMMANDS, PATIENCE_S, Stand, wait_until
from vcu_gateway.client import Client, ClientError

BENCH = """
bench:
  auto_arm: true
  demand: {bench_use_only: true, throttle_pct: 20, power_mode: normal}
"""
QUIET = "steps:\n  - {at_s: 0, fault: silence, of: IMU}\n"
POWER_CUT = bytes.fromhex("8c000000e02e0000")
# The second form is wrong, and done all the same.
FORMS = ({"params": {}}, {"params": []})
KILLED_WITHIN_S = 0.065
FIRST_FRAMES = 10
EXTENDED, EXTENDED_ONLY = 1 << 31, 0xDFFF_FFFF


class Listener:
    """The command frames on the bus, in their order."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
        filters = [struct.pack("=II", EXTENDED | can_id, EXTENDED_ONLY) for can_id in COMMANDS]
        self.socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, b"".join(filters))
        self.socket.bind((CHANNEL,))
        self.socket.setblocking(False)

    def frames(self) -> list[bytes]:
        """The data of those since the last call."""
        found = []
        with contextlib.suppress(BlockingIOError):
            while True:
                found.append(self.socket.recv(16)[8:])
        return found

    def next_frames(self, count: int) -> list[bytes]:
        found: list[bytes] = []

        def enough() -> bool:
            found.extend(self.frames())
            return len(found) >= count

        wait_until(enough, f"{count} command frames")
        return found


@pytest.fixture
def listener() -> Iterator[Listener]:
    one = Listener()
    yield one
    one.socket.close()


class Kill(NamedTuple):
    """One kill: what was known of the stop before it, and what the next gateway made of it."""

    answered: bool
    on_the_bus: bool
    latched: bool
    torque_after_the_cut: bool

    @property
    def lost(self) -> bool:
        return (self.answered or self.on_the_bus) and not self.latched


class Killing:
    """One gateway after the other, each killed around an emergency stop while it drives."""

    def __init__(self, stand: Stand, listener: Listener, runtime: Path) -> None:
        self.stand, self.listener = stand, listener
        self.runtime = stand.runtime = runtime
        self.chance = random.Random(23)
        self.gateway = stand.gateway(BENCH)

    def drive(self) -> None:
        """Until there is throttle: reset and armed where a stop is latched, else by itself."""

        def drives() -> bool:
            if any(data[1] for data in self.listener.frames()):
                return True
            with (
                contextlib.suppress(ClientError),
                Client(self.stand.socket_path, timeout_s=PATIENCE_S) as operator,
            ):
                mode = operator.why()["mode"]
                if mode == "fault":
                    operator.reset("service")
                elif mode == "standby":
                    operator.arm()
            return False

        wait_until(drives, "throttle")

    def kill(self) -> Kill:
        request = {"jsonrpc": "2.0", "id": 1, "method": "estop", **self.chance.choice(FORMS)}
        with socket.socket(socket.AF_UNIX) as operator:
            operator.settimeout(PATIENCE_S)
            operator.connect(str(self.stand.socket_path))
            self.listener.frames()
            operator.sendall(json.dumps(request).encode() + b"\n")
            time.sleep(self.chance.uniform(0, KILLED_WITHIN_S))  # the moment of the kill
            self.gateway.stop(signal.SIGKILL)
            answer = _received(operator)
        sent = self.listener.frames()
        cut = next((place for place, data in enumerate(sent) if data[0] & 0x80), len(sent))
        (self.runtime / "starts").unlink()  # or the third kill would end arming
        self.gateway = self.stand.gateway(BENCH)
        first = self.listener.next_frames(FIRST_FRAMES)
        return Kill(
            answered=b"granted" in answer or b"done all the same" in answer,
            on_the_bus=cut < len(sent),
            latched=set(first) == {POWER_CUT},
            torque_after_the_cut=any(data[1] for data in [*sent[cut:], *first]),
        )


def _received(operator: socket.socket) -> bytes:
    """What the gateway had answered before its end."""
    found = b""
    with contextlib.suppress(ConnectionError):
        while part := operator.recv(65536):
            found += part
    return found


@pytest.mark.parametrize(
    "kills", [4, pytest.param(200, marks=[pytest.mark.slow, pytest.mark.timeout(2400)])]
)
def test_a_stop_that_was_told_or_seen_is_latched_at_the_next_start(
    stand: Stand, listener: Listener, tmp_path: Path, figures: list[str], kills: int
):
    stand.vehicle(QUIET)
    killing, done = Killing(stand, listener, tmp_path / "kept"), []
    for _ in range(kills):
        killing.drive()
        done.append(killing.kill())
    counts = {name: sum(getattr(one, name) for one in done) for name in Kill._fields}
    lost = [one for one in done if one.lost]
    figures.append(f"{kills} kills around an emergency stop: {counts}, {len(lost)} lost")
    assert not lost, lost
    assert not counts["torque_after_the_cut"], done
