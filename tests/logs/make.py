"""Make the recordings in this directory: the simulated vehicle, in simulated time.

The same bytes come out every time. The expected results come from cantools, which shares no
code with the gateway's decoder.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import can
import cantools

from vcu_gateway import simulator
from vcu_gateway.core.codec import Codec
from vcu_gateway.protocol import dbc, packaged

FIRST_STAMP_S = 1_700_000_000
COMMAND_PERIOD_NS = 50_000_000
# The first commands, clear of every cyclic message; one frame at 250 kbit/s takes 0.6 ms.
COMMAND_AT_NS = {"PCU1": 20_000_000, "PCU2": 20_600_000}
S_NS = 1_000_000_000


class Sent(NamedTuple):
    """One frame on the bus."""

    at_ns: int
    can_id: int
    data: bytes
    message: str


def driver(elapsed_s: float) -> Mapping[str, float]:
    """What both controllers are told: pull away, coast, brake and recover."""
    values = {"PowerMode": 1, "SpeedLimit": 6000, "PowerLimit": 12000}
    if elapsed_s < 0.5:
        return values
    if elapsed_s < 3.0:
        return values | {"Throttle": min(39.0, 39.0 * (elapsed_s - 0.5))}
    if elapsed_s < 3.75:
        return values
    return values | {"Brake": 7.8, "RegenBrake": 1}


def traffic(duration_ns: int) -> Iterator[Sent]:
    """Everything on the bus, commands included, in the order of time."""
    codec = Codec(dbc.load(packaged("vcu.dbc")))
    nodes = simulator.build(codec, 0, seed=1)
    commands_ns = dict(COMMAND_AT_NS)
    while True:
        controller = min(commands_ns, key=lambda name: commands_ns[name])
        now_ns = min(commands_ns[controller], nodes.next_due_ns())
        if now_ns >= duration_ns:
            return
        for frame in nodes.due(now_ns):
            yield Sent(frame.due_ns, frame.can_id, frame.data, frame.message)
        if now_ns == commands_ns[controller]:
            commands_ns[controller] += COMMAND_PERIOD_NS
            message = codec.by_name[f"VCU_{controller}_Command"]
            data = message.encode(driver(now_ns / S_NS))
            nodes.receive(message.spec.can_id, data, now_ns)
            yield Sent(now_ns, message.spec.can_id, data, message.spec.name)


def candump(frames: list[Sent]) -> str:
    """The frames as lines of `candump -L`."""
    return "".join(
        f"({_stamp(frame.at_ns)}) vcan0 {frame.can_id:08X}#{frame.data.hex().upper()}\n"
        for frame in frames
    )


def _stamp(at_ns: int) -> str:
    seconds, rest_ns = divmod(at_ns, S_NS)
    return f"{FIRST_STAMP_S + seconds}.{rest_ns // 1_000:06d}"


def expected(log: Path) -> dict[str, Any]:
    """Count and last contents of each message in a log, read by python-can and cantools."""
    database: Any = cantools.database.load_file(packaged("vcu.dbc"))
    counts: Counter[str] = Counter()
    last = {}
    with can.LogReader(log) as reader:
        for frame in reader:
            message = database.get_message_by_frame_id(frame.arbitration_id)
            counts[message.name] += 1
            last[message.name] = bytes(frame.data)
    return {
        name: {
            "count": counts[name],
            "data": data.hex().upper(),
            "values": _decoded(database, name, data, scaling=True),
            "raws": _decoded(database, name, data, scaling=False),
        }
        for name, data in sorted(last.items())
    }


def _decoded(database: Any, name: str, data: bytes, *, scaling: bool) -> dict[str, float]:
    message = database.get_message_by_name(name)
    decoded: dict[str, float] = message.decode(data, decode_choices=False, scaling=scaling)
    return decoded


def make(directory: Path) -> None:
    """Write every recording and its expected results into this directory."""
    nominal = [f for f in traffic(5 * S_NS) if not f.message.startswith("VCU_")]
    drive = list(traffic(3 * S_NS))
    for name, frames in (("nominal", nominal), ("drive", drive)):
        (directory / f"{name}.log").write_text(candump(frames), encoding="ascii", newline="\n")
    golden = json.dumps(expected(directory / "nominal.log"), indent=2)
    (directory / "nominal.expected.json").write_text(golden + "\n", encoding="ascii", newline="\n")


if __name__ == "__main__":
    make(Path(__file__).parent)
