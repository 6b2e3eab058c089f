"""The programs under test: how each is started, where, and with which byte code."""

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tests.processors import started_on

from bench import CHANNEL, wire
from bench.figures import Options

HERE = Path(__file__).resolve().parent.parent
_FLOOR = HERE / "build" / "bench" / "floor"

# A test bench that arms itself: the gateway has all its work to do. The traffic's controllers stand
# still; below 15 % that is no controller that does not obey, which would be found in every tick.
_CONFIG = """
bus: {{channel: {channel}}}
log: {{level: error}}
api: {{socket_path: {folder}/control.sock}}
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
        config: what its configuration has besides, in whole lines.
    """

    name: str
    words: tuple[str, ...]
    tree: Path | None = None
    config: str = ""

    def command(self, stand_in: int | None, folder: Path) -> list[str]:
        """Command line on the bus, or on a socket in place of it."""
        if self.words[0] == "floor":
            return [
                str(floor()),
                *self.words[1:],
                CHANNEL if stand_in is None else str(stand_in),
            ]
        found = [sys.executable, "-m", *self.words]
        if self.tree is not None:
            found.append(str(folder / "gateway.yaml"))
        return found if stand_in is None else [*found, f"stand-in={stand_in}"]

    def environment(self, folder: Path) -> dict[str, str]:
        """Only byte code is left of earlier runs, and that in any case."""
        kept = {name: value for name, value in os.environ.items() if name not in _UNWANTED}
        return {
            **kept,
            "PYTHONPATH": f"{(self.tree or HERE) / 'src'}:{HERE}",
            "PYTHONPYCACHEPREFIX": str(_folder() / "byte code"),
            "RUNTIME_DIRECTORY": str(folder),
        }


OTHER = "other tree"
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


def floors() -> list[Program]:
    """The C programs; none where they cannot be had."""
    return [C_A_TICK, C_A_FRAME] if floor() else []


@contextlib.contextmanager
def run_folder(more: str = "") -> Iterator[Path]:
    """Configuration, with these lines more, socket and state of one run."""
    with tempfile.TemporaryDirectory(dir=_folder()) as name:
        # Where no real bus holds them apart, two gateways must not meet by the name of their bus.
        channel = CHANNEL if wire.has_vcan() else f"bench{os.getpid()}"
        config = _CONFIG.format(channel=channel, folder=name)
        Path(name, "gateway.yaml").write_text(f"{config}{more}", encoding="utf-8")
        yield Path(name)


@cache
def processors() -> tuple[set[int], set[int]]:
    """Processors of the program under test, and of everything else; the same where there is one."""
    there = sorted(os.sched_getaffinity(0))
    return set(there[-1:]), set(there[:-1]) or set(there)


@cache
def _folder() -> Path:
    _kept.append(tempfile.TemporaryDirectory(prefix="bench-"))
    return Path(_kept[0].name)


_kept: list[tempfile.TemporaryDirectory[str]] = []


@cache
def floor() -> Path | None:
    """floor.c compiled, and kept for machines without a compiler; None where it never was."""
    source = Path(__file__).with_name("floor.c")
    is_current = _FLOOR.exists() and _FLOOR.stat().st_mtime > source.stat().st_mtime
    if not is_current and shutil.which("cc"):
        _FLOOR.parent.mkdir(parents=True, exist_ok=True)
        subprocess.run(["cc", "-O2", "-o", _FLOOR, source], check=True)
    return _FLOOR if _FLOOR.exists() else None


def on_its_processor() -> contextlib.AbstractContextManager[None]:
    """Programs started in the block run where the program under test does."""
    return started_on(processors()[0])
