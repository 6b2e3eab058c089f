"""Golden drives: what is driven in each of them, and which faults of the catalogue it holds.

A drive is a function of a `ScriptedDrive`; its name is the drive's, its docstring what a reader of
a report is told. A drive begins healthy and breaks one thing after the other, at and beside the
limits of docs/safety.md.
"""

import functools
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from tests.core.simulated_drive import CODEC
from tests.golden.scripted_drive import START_NS, ScriptedDrive
from vcu_gateway.core.codec import Codec
from vcu_gateway.protocol import dbc

DEFAULTS = "bus: {channel: can0}"


ROOT = Path(__file__).parents[2]
DBC = ROOT / "dbc" / "vcu.dbc"


@functools.cache
def codec_of(path: Path) -> Codec:
    return CODEC if path == DBC else Codec(dbc.load(path))


class GoldenDrive(NamedTuple):
    """A drive that is recorded once and replayed to the byte ever after.

    Attributes:
        config: the gateway's configuration, as a file would have it.
        faults: numbers of the catalogue's faults that it holds.
        quiet: without the inertial unit, which is nine tenths of the traffic.
        scenario: a file of config/scenarios, or empty.
        dbc: file of the protocol.
    """

    name: str
    script: Callable[[ScriptedDrive], None]
    config: str = DEFAULTS
    faults: tuple[int, ...] = ()
    quiet: bool = True
    scenario: str = ""
    start_ns: int = START_NS
    dbc: Path = DBC

    @property
    def codec(self) -> Codec:
        return codec_of(self.dbc)

    @property
    def title(self) -> str:
        return (self.script.__doc__ or "").splitlines()[0]


DRIVES: dict[str, GoldenDrive] = {}
Script = Callable[[ScriptedDrive], None]


def golden(
    *faults: int,
    config: str = DEFAULTS,
    quiet: bool = True,
    start_ns: int = START_NS,
    dbc: Path = DBC,
) -> Callable[[Script], Script]:
    """Make a golden drive of a script."""

    def added(script: Script) -> Script:
        name = script.__name__.replace("_", "-")
        DRIVES[name] = GoldenDrive(name, script, config, faults, quiet, "", start_ns, dbc)
        return script

    return added
