"""Gateway with pedals on CAN on vcan0, and a pedal node in a process of its own."""

import contextlib
import functools
import itertools
import socket
import struct
from itertools import count
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path

from tests.vcan.conftest import CHANNEL, Process, Recorded, Recording, Stand, wait_until
from tests.vcan.test_api import Drive
from vcu_gateway.client import RefusedError
from vcu_gateway.config import core_settings, load
from vcu_gateway.core.codec import Codec, MessageCodec
from vcu_gateway.core.curve import Curve
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.simulator.pedals import Foot, PedalNode

MS = 1_000_000
SLACK_MS = 5  # from reading the pedals in a tick to the second frame of it on the bus
PEDALS_ID = 0x0810D021
EFF = 0x8000_0000
PERIOD_S = 0.020
SILENT_MS = 60  # without a frame of the pedals a drive ends
RELEASED, PRESSED = 0.0, 43.0  # travel, %
ASKED_RAW = 109  # what PRESSED asks for between the dead zones, 42.55 %

Frames = dict[float, list[bytes]]


class PedalDrive(Drive):
    """A gateway in standby that takes this node's frames as demands, a vehicle and a recorder."""

    def __init__(self, stand: Stand, recording: Recording, gateway: Process) -> None:
        super().__init__(stand, recording, gateway)
        self._foot, theirs = Pipe()
        self._released = _frames()[RELEASED]
        stand.run(functools.partial(_send, theirs, _frames()))

    def press(self, travel_pct: float | None) -> None:
        """Move the throttle pedal; a frame says so at once. None: the node is unplugged."""
        self._foot.send(travel_pct)

    def until_armed(self) -> None:
        """As soon as it is granted, with released pedals."""
        self.press(RELEASED)
        arm_when_granted(self)

    def until_driving(self) -> None:
        """Armed and pressed; once more where the node stood still so long that the drive ended."""
        self.until_armed()
        since_ns = self.pedal_frames()[-1].stamp_ns
        self.press(PRESSED)
        wait_until(
            lambda: self.last_throttle() == ASKED_RAW or self._stood_still(since_ns),
            "throttle on the bus",
        )
        if self.last_throttle() != ASKED_RAW:
            self.until_driving()

    def _stood_still(self, since_ns: int) -> bool:
        stamps_ns = [f.stamp_ns for f in self.pedal_frames() if f.stamp_ns >= since_ns]
        gaps_ns = [after - before for before, after in itertools.pairwise(stamps_ns)]
        with self.client as client:
            return max(gaps_ns, default=0) > SILENT_MS * MS and client.why()["mode"] == "standby"

    def pedal_frames(self) -> list[Recorded]:
        return [frame for frame in self.recording.frames() if frame.can_id == PEDALS_ID]

    def is_pressed(self, frame: Recorded) -> bool:
        """Whether this frame of the node has throttle."""
        return all(frame.data[:6] != one[:6] for one in self._released)


def followed(moved: Recorded, commands: list[Recorded], *, throttle: bool) -> tuple[float, float]:
    """From the pedals' frame to the command that follows it, and the period that it ends; ms."""
    for before, first in itertools.pairwise(commands):
        if first.stamp_ns > moved.stamp_ns and (first.data[1] > 0) == throttle:
            return (first.stamp_ns - moved.stamp_ns) / MS, (first.stamp_ns - before.stamp_ns) / MS
    raise AssertionError(f"no command {'with' if throttle else 'without'} throttle follows")


def arm_when_granted(drive: Drive) -> None:
    def armed() -> bool:
        with drive.client as client, contextlib.suppress(RefusedError):
            client.arm()
        with drive.client as client:
            return client.why()["mode"] == "active"

    wait_until(armed, f"active; the gateway: {drive.gateway.err}")


def signals(frame: Recorded) -> dict[str, int]:
    """Codes of a frame of the pedals by their signals."""
    message = _message()
    decoded = message.decode(frame.data)
    return dict(zip(message.spec.signal_names, decoded.raws, strict=True))


@functools.cache
def _message() -> MessageCodec:
    return Codec(dbc.load(packaged("pedals.dbc"))).by_name["Pedals_Position"]


def configured(folder: Path) -> str:
    """The packaged example; its DBC beside the gateway's configuration."""
    (folder / "pedals.dbc").write_bytes(packaged("pedals.dbc").read_bytes())
    return packaged("pedals.yaml").read_text("utf-8")


def _send(foot: Connection, frames: Frames) -> None:
    travel_pct: float | None = RELEASED
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        bus.bind((CHANNEL,))
        for number in count():
            if travel_pct is not None:
                data = frames[travel_pct][number % 16]
                bus.send(struct.pack("<IB3x8s", EFF | PEDALS_ID, len(data), data))
            if foot.poll(PERIOD_S):
                travel_pct = foot.recv()


def _frames() -> Frames:
    """By travel one for each value of the counter."""
    codec = _message()
    pedals = core_settings(load(packaged("pedals.yaml"))).pedals
    assert pedals is not None
    found = {}
    for travel_pct in (RELEASED, PRESSED):
        foot = Foot(throttle_pct=Curve(((0.0, travel_pct), (1.0, travel_pct))))
        node = PedalNode(pedals, codec, foot)
        found[travel_pct] = [node.seal(codec.encode(node.values(0.0, n))) for n in range(16)]
    return found
