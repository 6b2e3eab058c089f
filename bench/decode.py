"""Decoding the traffic mix: frame to values, against cantools `decode_message`."""

from collections.abc import Iterator
from typing import Any

import cantools

from bench import DBC
from bench.figures import Figure, Options, compared, in_turns
from bench.traffic import codec, random_mix
from vcu_gateway.core.codec import MessageCodec
from vcu_gateway.core.j1939 import Frame


def figures(options: Options) -> Iterator[Figure]:
    mix = [(can_id, bytearray(data)) for can_id, data in random_mix()]
    frames = [Frame(can_id, data, 0) for can_id, data in mix]
    database: Any = cantools.database.load_file(DBC)
    find, decode_message = codec().find, database.decode_message
    found = [(message_of(frame).decode, frame.data) for frame in frames]

    def find_and_decode() -> None:
        for frame in frames:
            message = find(frame)
            if isinstance(message, MessageCodec):
                message.decode(frame.data)

    def decode_only() -> None:
        for decode, data in found:
            decode(data)

    def by_cantools() -> None:
        for can_id, data in mix:
            decode_message(can_id, data)

    ways = {"both": find_and_decode, "decode": decode_only, "cantools": by_cantools}
    took = {
        name: [ns / len(mix) / 1e3 for ns in taken]
        for name, taken in in_turns(ways, calls=5, repeats=options.repeats(100)).items()
    }
    peer = took["cantools"]
    name = "decode a frame of the mix"
    yield compared(name, "µs", took["decode"], peer, "cantools", 1 / 4, 1 / 5)
    yield compared("find its message and decode it", "µs", took["both"], peer, "cantools")


def message_of(frame: Frame) -> MessageCodec:
    message = codec().find(frame)
    if not isinstance(message, MessageCodec):
        raise TypeError(f"{frame} is not in the protocol: {message}")
    return message
