"""Encoding a command, every field held inside its range, against cantools strict."""

import random
from collections.abc import Iterator
from typing import Any

import cantools

from bench import DBC
from bench.figures import Figure, Options, compared, in_turns
from bench.traffic import codec

_COMMAND = "VCU_PCU1_Command"


def figures(options: Options) -> Iterator[Figure]:
    ours = codec().by_name[_COMMAND]
    rng = random.Random(2)
    commands = [
        {
            signal.name: rng.randint(signal.raw_minimum, signal.raw_maximum) * signal.factor
            for signal in ours.spec.signals
        }
        for _ in range(100)
    ]
    database: Any = cantools.database.load_file(DBC)
    theirs = database.get_message_by_name(_COMMAND)

    def by_us() -> None:
        for values in commands:
            ours.encode(values)

    def by_cantools() -> None:
        for values in commands:
            theirs.encode(values, strict=True)

    ways = {"ours": by_us, "cantools": by_cantools}
    took = in_turns(ways, calls=10, repeats=options.repeats(60))
    ours_us, peer_us = ([ns / len(commands) / 1e3 for ns in took[name]] for name in ways)
    name = "encode a command with range checks"
    yield compared(name, "µs", ours_us, peer_us, "cantools strict", 1 / 10, 1 / 15)
