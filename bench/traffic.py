"""The vehicle's traffic: the periods of docs/protocol.md, Messages; 358 frames/s."""

import random
import struct
from collections.abc import Iterator
from functools import cache

from bench import DBC
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.spec import MessageSpec
from vcu_gateway.protocol import dbc

NOMINAL_PER_S = 358
SATURATED_PER_S = 7600

# message: period, first in the second, and its place in a burst (ms). A sensor sends its frames
# back to back: one frame takes about 0.55 ms at 250 kbit/s.
_TIMETABLE_MS = {
    "IMU_Acceleration": (10, 0.0),
    "IMU_AngularRate": (10, 0.55),
    "IMU_Attitude": (10, 1.1),
    "PCU1_Status2": (50, 4.0),
    "PCU2_Status2": (50, 4.6),
    "ARD2_SteeringWheel": (100, 7.0),
    "PCU1_Status1": (500, 27.0),
    "PCU2_Status1": (500, 38.0),
    "BMS_Status": (500, 146.0),
    "BMS_Temperatures": (500, 146.6),
}

# What a vehicle at rest reports; anything else is the code nearest to 0.
_AT_REST = {
    "PackVoltage": 76.0,
    "SOC": 80,
    "BatteryVoltage": 76.0,
    "VoltageLevel": 3,
    "ControllerTemperature": 35,
    "MotorTemperature": 35,
    **{f"PackTemperature{i}": 25 for i in range(1, 6)},
    "AccelerationZ": 9.81,
}
_FRAME = struct.Struct("=IB3x8s")
_EFF_FLAG = 0x8000_0000

Wire = bytes
"""A frame as SocketCAN hands it over: 16 bytes."""


@cache
def codec() -> Codec:
    """The project's DBC, compiled."""
    return Codec(dbc.load(DBC))


def on_wire(can_id: int, data: bytes) -> Wire:
    """struct can_frame of an extended data frame."""
    return _FRAME.pack(can_id | _EFF_FLAG, len(data), data)


def wire_parts(frame: Wire) -> tuple[int, bytes]:
    """Identifier without flags, and data, of an extended data frame."""
    can_id, length, data = _FRAME.unpack(frame)
    return can_id & ~_EFF_FLAG, data[:length]


def random_mix(seed: int = 1) -> list[tuple[int, bytes]]:
    """One second of the traffic in random order, every signal anywhere in its range."""
    rng = random.Random(seed)
    frames = []
    for name, (period_ms, _) in _TIMETABLE_MS.items():
        spec = codec().by_name[name].spec
        frames += [(spec.can_id, _random_data(spec, rng)) for _ in range(1000 // period_ms)]
    rng.shuffle(frames)
    return frames


def _random_data(spec: MessageSpec, rng: random.Random) -> bytes:
    bits = 0
    for signal in spec.signals:
        raw = rng.randint(signal.raw_minimum, signal.raw_maximum)
        for weight, position in enumerate(signal.bit_positions()):
            bits |= (raw >> weight & 1) << position
    return bits.to_bytes(8, "little")


def second_at_rest(life: bool) -> list[tuple[int, Wire]]:
    """One second of a healthy vehicle: (ns from its start, frame), in order of time."""
    frames = []
    for name, (period_ms, first_ms) in _TIMETABLE_MS.items():
        message = codec().by_name[name]
        for turn in range(1000 // period_ms):
            values = _AT_REST | {"LifeSignal": (turn + life) % 2}
            frame = on_wire(message.spec.can_id, message.encode(values))
            frames.append((int((first_ms + turn * period_ms) * 1e6), frame))
    return sorted(frames)


def timetable(per_s: float | None) -> Iterator[tuple[int, Wire]]:
    """Endless traffic: (ns from the start, frame).

    At the nominal rate each message has its period; at any other the same mix is spread
    evenly. None: everything is due at once, as fast as it can be sent.
    """
    second = second_at_rest(life=False)
    if per_s == NOMINAL_PER_S:
        index = 0
        while True:
            yield from ((index * 10**9 + at_ns, frame) for at_ns, frame in second)
            index += 1
    gap_ns = 1e9 / per_s if per_s else 0.0
    count = 0
    while True:
        for _, frame in second:
            yield int(count * gap_ns), frame
            count += 1
