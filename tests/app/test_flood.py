"""A flood of the API costs its senders, not the ticks.

Any busy process delays a gateway that has no priority on its processor. That is not what is
measured here: where there are two processors the gateway has one and the flood the other. The
ordinary run has company on both, so it leaves the last percent of the ticks out, compares with a
process that is as busy and leaves the API alone, and measures again where that company may have
come in the flood's turn; the nightly one compares with silence.
"""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.driven import armed, wait_until
from tests.processors import started_on
from vcu_gateway.client import Client, DemandOwner

SHARES = (0.5, 0.9, 0.99)
CLIENTS = 50
ROUNDS = 4
# Undisturbed, most ticks begin within some microseconds, twice of which is nothing to ask for.
PUNCTUAL_US = 100.0
BUSY = [sys.executable, "-c", "while True: pass"]


@dataclass
class Ticking:
    """A gateway that is driven, and the times at which something was done to it."""

    folder: Path
    process: subprocess.Popen[str]
    owner: DemandOwner

    @property
    def flood(self) -> list[str]:
        socket_path = str(self.folder / "control.sock")
        clients = ["--clients", str(CLIENTS), "--seconds", "100"]
        return [sys.executable, "-m", "tests.server.flood", socket_path, *clients]

    def during(self, command: list[str], seconds: float) -> tuple[int, int]:
        """Begin and end of so many seconds with this process beside it."""
        begin_ns = time.monotonic_ns()
        with contextlib.ExitStack() as stack:
            if command:
                process = stack.enter_context(subprocess.Popen(command))
                stack.callback(process.kill)
            time.sleep(seconds)
        return begin_ns, time.monotonic_ns()

    def lateness_us(self, begin_ns: int, end_ns: int) -> list[float]:
        """Percentiles of the ticks in between."""
        time.sleep(0.2)  # the last of them is written after it was taken
        lines = (self.folder / "lateness").read_text().splitlines()
        ticks = [tuple(map(int, line.split())) for line in lines]
        late = sorted(lateness for deadline, lateness in ticks if begin_ns <= deadline < end_ns)
        return [late[int(share * len(late))] / 1000 for share in SHARES]

    def end(self) -> None:
        self.process.terminate()
        self.process.wait(60)


@pytest.fixture
def ticking(tmp_path: Path) -> Iterator[Ticking]:
    command = [sys.executable, "-m", "tests.app.ticking", str(tmp_path)]
    first, *others = sorted(os.sched_getaffinity(0))
    with contextlib.ExitStack() as stack:
        with started_on({first}):
            process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        stack.enter_context(process)
        stack.enter_context(started_on(set(others) or {first}))
        try:
            assert process.stdout is not None
            # A line of its log, written at the same time, may stand before it.
            assert any(line.endswith("ready\n") for line in process.stdout)
            socket_path = tmp_path / "control.sock"
            with Client(socket_path) as client, client.demand("driver", hold_s=None) as owner:
                wait_until(lambda: armed(client), "a vehicle that may be armed")
                yield Ticking(tmp_path, process, owner)
        finally:
            process.kill()


def told(name: str, percentiles_us: list[float]) -> str:
    shares = zip(SHARES, percentiles_us, strict=True)
    return f"{name}: " + ", ".join(f"{share:.0%} of the ticks {us:.0f} us" for share, us in shares)


def within_twice(without_us: list[float], flooded_us: list[float]) -> bool:
    """Whether each percentile is at most twice as late; up to 100 µs a tick is punctual."""
    pairs = zip(without_us, flooded_us, strict=True)
    return all(flooded <= 2 * max(without, PUNCTUAL_US) for without, flooded in pairs)


def still_drives(ticking: Ticking) -> bool:
    return ticking.owner.last_answer is not None and ticking.owner.last_answer["mode"] == "active"


@pytest.mark.ci
@pytest.mark.clock
def test_a_flood_makes_the_ticks_no_later_than_any_busy_process_does(ticking: Ticking, capsys):
    for _ in range(ROUNDS):
        beside = ticking.lateness_us(*ticking.during(BUSY, 4))
        flooded = ticking.lateness_us(*ticking.during(ticking.flood, 5))
        with capsys.disabled():
            print(f"\n{told('beside a busy process', beside)}\n{told('flooded', flooded)}")
        if within_twice(beside[:2], flooded[:2]):
            break
    else:
        pytest.fail(f"in each of {ROUNDS} rounds the ticks were later than twice")
    ticking.end()


@pytest.mark.clock
@pytest.mark.slow
@pytest.mark.timeout(200)
def test_a_flood_of_30_s_keeps_the_lateness_of_the_ticks_within_twice(ticking: Ticking, capsys):
    quiet, flood = ticking.during([], 30), ticking.during(ticking.flood, 31)
    assert still_drives(ticking), "its owner's demand stayed fresh"
    ticking.end()
    without, flooded = ticking.lateness_us(*quiet), ticking.lateness_us(*flood)
    with capsys.disabled():
        print(f"\n{told('quiet', without)}\n{told('flooded', flooded)}")
    assert within_twice(without, flooded)
