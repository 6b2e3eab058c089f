"""Logs with random payloads of every message, and what cantools makes of them."""

import random
from pathlib import Path
from typing import Any, NamedTuple

import cantools

from vcu_gateway.protocol import dbc, packaged

PROTOCOL = dbc.load(packaged("vcu.dbc"))
START_NS = 1_763_920_000_123_456_789
PERIOD_NS = 7_654_321


class Sent(NamedTuple):
    """One frame of a log."""

    stamp_ns: int
    can_id: int
    message: str
    data: bytes


def random_frames(count: int, seed: int = 1) -> list[Sent]:
    """Each message in turn with any bytes."""
    generator, messages = random.Random(seed), PROTOCOL.messages
    return [
        Sent(START_NS + number * PERIOD_NS, one.can_id, one.name, generator.randbytes(8))
        for number in range(count)
        for one in [messages[number % len(messages)]]
    ]


def line(one: Sent) -> str:
    seconds, rest_ns = divmod(one.stamp_ns, 10**9)
    return f"({seconds}.{rest_ns:09d}) can0 {one.can_id:08X}#{one.data.hex().upper()} R\n"


def write_log(path: Path, frames: list[Sent]) -> Path:
    path.write_text("".join(map(line, frames)))
    return path


def by_cantools(frames: list[Sent]) -> dict[str, list[tuple[int, dict]]]:
    """Stamp and values of every frame, by message."""
    database = cantools.database.load_file(packaged("vcu.dbc"))
    found: dict[str, list[tuple[int, dict]]] = {}
    for one in frames:
        values: Any = database.decode_message(one.message, one.data, decode_choices=False)
        found.setdefault(one.message, []).append((one.stamp_ns, values))
    return found
