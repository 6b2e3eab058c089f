"""The programs under test: how each is started, where, and with which byte code."""

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from bench import CHANNEL
from bench.figures import Options

HERE = Path(__file__).resolve().parent.parent

# A test bench that arms itself: the gateway has all its work to do. The traffic's controllers stand
# still; below 15 % that is no controller that does not obey, which would be found in every tick.
_CONFIG = f"""
bus: {{channel: {CHANNEL}}}
log: {{level: error}}
bench:
  auto_arm: true
  demand: {{bench_use_only: true, throttle_pct: 10}}
"""

_UNWANTED = ("PYTHONDONTWRITEBYTECODE", "NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID")


@dataclass(frozen=True)
class Program:
    """A program under test.

    Attributes:
        tree: source tree of a gateway; None: it is not one.
        words: its command line, without what names the bus.
        echoes: whether its own frames come back to it.
    """

    name: str
    words: tuple[str, ...]
    tree: Path | None = None

    def command(self, stand_in: int | None) -> list[str]:
        """Command line on the bus, or on a socket in place of it."""
        if self.words[0] == "floor":
            return [str(floor()), *self.words[1:], CHANNEL if stand_in is None else str(stand_in)]
        found = [sys.executable, "-m", *self.words]
        if self.tree is not None:
            found.append(str(_folder() / "gateway.yaml"))
        return found if stand_in is None else [*found, f"stand-in={stand_in}"]


NAIVE = Program("naive", ("bench.naive",))
C_A_TICK = Program("C, one wake-up a tick", ("floor", "tick"))
C_A_FRAME = Program("C, one wake-up a frame", ("floor", "frame"))


def gateway(tree: Path, name: str = "ours", way: str = "timed") -> Program:
    """The gateway of a source tree; `way` is program.py's."""
    return Program(name, ("bench.program", way), tree)


def gateways(options: Options, way: str = "timed") -> list[Program]:
    """Ours, and that of the other tree where one is named."""
    found = [gateway(HERE, way=way)]
    if options.against is not None:
        found.append(gateway(options.against, OTHER, way))
    return found


OTHER = "other tree"


def floors() -> list[Program]:
    """The C programs; none where there is no compiler."""
    return [C_A_TICK, C_A_FRAME] if floor() else []


def environment(tree: Path | None = None) -> dict[str, str]:
    """What a program of this tree is started with: its byte code is kept, and nothing else's."""
    kept = {name: value for name, value in os.environ.items() if name not in _UNWANTED}
    return {
        **kept,
        "PYTHONPATH": f"{(tree or HERE) / 'src'}:{HERE}",
        "PYTHONPYCACHEPREFIX": str(_folder() / "byte code"),
        # A start of its own: none that ended badly before it counts.
        "RUNTIME_DIRECTORY": tempfile.mkdtemp(dir=_folder()),
    }


@cache
def processors() -> tuple[set[int], set[int]]:
    """Processors of the program under test, and of everything else; the same where there is one."""
    there = sorted(os.sched_getaffinity(0))
    return set(there[-1:]), set(there[:-1]) or set(there)


@cache
def _folder() -> Path:
    _kept.append(tempfile.TemporaryDirectory(prefix="bench-"))
    folder = Path(_kept[0].name)
    (folder / "gateway.yaml").write_text(_CONFIG)
    return folder


_kept: list[tempfile.TemporaryDirectory[str]] = []


@cache
def floor() -> Path | None:
    """floor.c compiled; None where there is no compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    target = _folder() / "floor"
    source = Path(__file__).with_name("floor.c")
    subprocess.run([compiler, "-O2", "-o", target, source], check=True)
    return target
