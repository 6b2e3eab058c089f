"""The installed service, by way of systemctl, and what systemd and the journal say of it."""

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from tests.vcan.conftest import wait_until

NAME = "vcu-gateway.service"
RUNTIME = Path("/run/vcu-gateway")
CONFIG = Path("/etc/vcu-gateway/gateway.yaml")
PATIENCE_S = 60.0
_NS_PER_US = 1_000


class Line(NamedTuple):
    """One line of the unit's journal; from systemd itself or from the program."""

    stamp_ns: int  # wall clock, when it was sent; of an output line, when the journal got it
    program: str
    text: str


class Signalled(NamedTuple):
    """When a signal was sent, wall clock; others may run before this process does again."""

    asked_ns: int
    done_ns: int


def systemctl(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemctl", *arguments], capture_output=True, text=True)


def wall_ns(monotonic_us: int) -> int:
    """A stamp of systemd as a stamp of the bus."""
    return monotonic_us * _NS_PER_US + min(_between_clocks() for _ in range(20)).wall_ns


class _Offset(NamedTuple):
    """From the monotonic clock to the wall clock; wrong by no more than the reading took."""

    took_ns: int
    wall_ns: int


def _between_clocks() -> _Offset:
    begun_ns, wall_ns, ended_ns = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
    return _Offset(ended_ns - begun_ns, wall_ns - ended_ns)


@dataclass
class Unit:
    """The service; `since_s` is where its journal is read from."""

    since_s: float = field(default_factory=time.time)

    def start(self) -> None:
        self._must("start")

    def stop(self) -> None:
        self._must("stop")

    def restart(self) -> None:
        self._must("restart")

    def _must(self, verb: str) -> None:
        done = systemctl(verb, NAME)
        assert done.returncode == 0, f"{done.stderr}{self.told()}"

    def status(self) -> str:
        """What a person sees."""
        return systemctl("status", "--no-pager", "--full", NAME).stdout

    def told(self) -> str:
        """The journal, for a test that fails."""
        return "\n".join(line.text for line in self.journal())

    def show(self, name: str) -> str:
        """A property, as text."""
        return self.shown(name)[name]

    def shown(self, *names: str) -> dict[str, str]:
        """Several at once."""
        lines = systemctl("show", NAME, f"--property={','.join(names)}").stdout.splitlines()
        return {name: value for name, _, value in (line.partition("=") for line in lines)}

    def number(self, name: str) -> int:
        """A property that is a number; stamps are in us of the monotonic clock."""
        return int(self.show(name))

    def stamp_ns(self, name: str) -> int:
        """One of systemd's stamps on the wall clock, such as ActiveExit."""
        return wall_ns(self.number(f"{name}TimestampMonotonic"))

    @property
    def pid(self) -> int:
        return self.number("MainPID")

    def signal(self, number: int) -> Signalled:
        """Send it to the main process."""
        pid = self.pid
        asked_ns = time.time_ns()
        os.kill(pid, number)
        return Signalled(asked_ns, time.time_ns())

    def kill(self) -> Signalled:
        return self.signal(signal.SIGKILL)

    def until_restarted(self, times: int = 1) -> None:
        """READY again, and that many automatic restarts behind it."""

        def restarted() -> bool:
            shown = self.shown("NRestarts", "ActiveState")
            return int(shown["NRestarts"]) >= times and shown["ActiveState"] == "active"

        wait_until(restarted, f"restart {times}", PATIENCE_S)
        assert self.number("NRestarts") == times, self.told()

    def journal(self) -> list[Line]:
        command = ["journalctl", f"--since=@{self.since_s:.6f}", "--output=json", f"--unit={NAME}"]
        lines = subprocess.run(command, capture_output=True, text=True).stdout.splitlines()
        entries = [json.loads(line) for line in lines]
        return [
            Line(
                int(entry.get("_SOURCE_REALTIME_TIMESTAMP", entry["__REALTIME_TIMESTAMP"]))
                * _NS_PER_US,
                entry.get("SYSLOG_IDENTIFIER", ""),
                str(entry["MESSAGE"]),
            )
            for entry in entries
        ]

    def said(self, words: str, since_ns: int = 0) -> Line:
        """The first line with these words, waited for: the journal is a process of its own."""
        found: list[Line] = []

        def there() -> bool:
            later = (line for line in self.journal() if line.stamp_ns >= since_ns)
            found[:] = [line for line in later if words in line.text]
            return bool(found)

        wait_until(there, f"{words!r} in the journal", PATIENCE_S)
        return found[0]

    def clear(self) -> None:
        """Stopped, with nothing left of earlier runs."""
        systemctl("stop", NAME)
        shutil.rmtree(RUNTIME, ignore_errors=True)


def exec_start() -> str:
    """The unit's ExecStart, as written."""
    lines = systemctl("cat", NAME).stdout.splitlines()
    return next(line for line in lines if line.startswith("ExecStart=")).partition("=")[2]


@contextmanager
def drop_in(text: str, name: str = NAME) -> Iterator[None]:
    """The unit of this name with these lines besides."""
    path = Path(f"/run/systemd/system/{name}.d/test.conf")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    systemctl("daemon-reload")
    try:
        yield
    finally:
        shutil.rmtree(path.parent)
        systemctl("daemon-reload")
