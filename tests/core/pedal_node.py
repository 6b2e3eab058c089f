"""Pedal node beside the healthy nodes of a drive: its message, its frames, a driver's feet."""

from dataclasses import replace
from typing import Any

from tests.core.simulated_drive import MS, PERIOD_NS, PROTOCOL, Drive
from vcu_gateway.core.can_pedals import CanPedals, PedalChecksum, PedalTrack
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.spec import MessageSpec, SignalSpec
from vcu_gateway.core.supervisor import Mode

PERIOD_MS = 20
POSITION = MessageSpec(
    "Pedals_Position",
    0x0810D021,
    "PEDALS",
    ("VCU",),
    PERIOD_MS,
    (
        SignalSpec("Throttle1", 0, 12, 0, 5, factor=0.00125, unit="V"),
        SignalSpec("Throttle2", 12, 12, 0, 5, factor=0.00125, unit="V"),
        SignalSpec("BrakePressure", 24, 10, 0, 100, factor=0.1, unit="bar"),
        SignalSpec("ReverseSwitch", 34, 2, 0, 3),
        SignalSpec("Counter", 48, 4, 0, 14),
        SignalSpec("Checksum", 56, 8, 0, 255),
    ),
)
CODEC = Codec(replace(PROTOCOL, messages=(*PROTOCOL.messages, POSITION)))
PEDALS = CanPedals(
    message="Pedals_Position",
    throttle=PedalTrack("Throttle1", 0.625, 3.75),  # codes 500 to 3000
    throttle_track2=PedalTrack("Throttle2", 0.3125, 1.875),  # codes 250 to 1500
    brake=PedalTrack("BrakePressure", 0.5, 60.5),  # codes 5 to 605
    counter="Counter",
    checksum=PedalChecksum("Checksum", "xor"),
    reverse="ReverseSwitch",
)


def frame_data(counter: int, *, flip: int = 0, **raws: int) -> bytes:
    """A frame's data; `flip` are bits of the checksum that are wrong."""
    raws = {"Throttle1": 500, "Throttle2": 250, "BrakePressure": 5} | raws
    bits = counter << 48
    for signal in POSITION.signals:
        bits |= raws.get(signal.name, 0) << signal.start_bit
    checksum = 0
    for byte in bits.to_bytes(8, "little")[:7]:
        checksum ^= byte
    return (bits | (checksum ^ flip) << 56).to_bytes(8, "little")


def pressed(throttle_pct: float, brake_pct: float = 0.0) -> dict[str, int]:
    """Codes of this travel of both tracks and of the brake."""
    return {
        "Throttle1": round(500 + 25 * throttle_pct),
        "Throttle2": round(250 + 12.5 * throttle_pct),
        "BrakePressure": round(5 + 6 * brake_pct),
    }


class PedalDrive(Drive):
    """A drive whose demands are frames of the pedal node, one each 20 ms.

    Attributes:
        feet: codes of the next frames.
        speaks: the node sends.
    """

    def __init__(self, pedals: CanPedals = PEDALS, **settings: Any) -> None:
        super().__init__()
        self.gateway = Gateway(CODEC, Settings(**settings, pedals=pedals), self.now_ns)
        self.demanded = None
        self.feet = pressed(0)
        self.speaks = True
        self._counter = 0

    def pedal(self, at_ns: int, *, flip: int = 0, skip: int = 0, **raws: int) -> None:
        """One frame of the node; `skip` frames before it were lost."""
        self._counter = (self._counter + 1 + skip) % 15
        data = frame_data(self._counter, flip=flip, **self.feet | raws)
        self.gateway.receive(Frame(POSITION.can_id, data, at_ns))

    def tick(self, after_ns: int = PERIOD_NS) -> TickResult:
        before_ns, now_ns, period_ns = self.now_ns, self.now_ns + after_ns, PERIOD_MS * MS
        first_ns = (before_ns // period_ns + 1) * period_ns
        for at_ns in range(first_ns, now_ns + 1, period_ns) if self.speaks else ():
            self.pedal(at_ns)
        return super().tick(after_ns)

    @property
    def throttles(self) -> list[int]:
        """Raw throttle of both controllers' last commands."""
        return [command[1] for command in self.commands]


def driving(throttle_pct: float = 0.0, **settings: Any) -> PedalDrive:
    """In ACTIVE, with the pedal at this travel for long enough."""
    drive = PedalDrive(**settings).until(Mode.STANDBY)
    drive.run(1500)
    answer = drive.arm()
    assert answer.granted, answer.sentence
    drive.feet = pressed(throttle_pct)
    drive.run(1500)
    return drive
