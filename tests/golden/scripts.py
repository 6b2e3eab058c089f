"""Golden drives: what is driven in each of them, and which faults of the catalogue it holds.

A drive is a function of a `ScriptedDrive`; its name is the drive's, its docstring what a reader of
a report is told. A drive begins healthy and breaks one thing after the other, at and beside the
limits of docs/safety.md.
"""

from collections.abc import Callable
from typing import NamedTuple

from tests.golden.scripted_drive import START_NS, ScriptedDrive

DEFAULTS = "bus: {channel: can0}"


class GoldenDrive(NamedTuple):
    """A drive that is recorded once and replayed to the byte ever after.

    Attributes:
        config: the gateway's configuration, as a file would have it.
        faults: numbers of the catalogue's faults that it holds.
        quiet: without the inertial unit, which is nine tenths of the traffic.
        scenario: a file of config/scenarios, or empty.
    """

    name: str
    script: Callable[[ScriptedDrive], None]
    config: str = DEFAULTS
    faults: tuple[int, ...] = ()
    quiet: bool = True
    scenario: str = ""
    start_ns: int = START_NS

    @property
    def title(self) -> str:
        return (self.script.__doc__ or "").splitlines()[0]


DRIVES: dict[str, GoldenDrive] = {}
Script = Callable[[ScriptedDrive], None]


def golden(
    *faults: int, config: str = DEFAULTS, quiet: bool = True, start_ns: int = START_NS
) -> Callable[[Script], Script]:
    """Make a golden drive of a script."""

    def added(script: Script) -> Script:
        name = script.__name__.replace("_", "-")
        DRIVES[name] = GoldenDrive(name, script, config, faults, quiet=quiet, start_ns=start_ns)
        return script

    return added
