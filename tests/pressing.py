"""Stops that are pressed while somebody attacks: how long each takes to the bus."""

import contextlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterable, Iterator
from typing import Any

import pytest

from tests.web.stand import PATIENCE_S, ROOT, GatewayProcess

BOUND_MS = 150.0
PRESSES = int(os.environ.get("VCU_PRESSES", "5"))
"""Each costs the hold of a fault, 1 s."""

_ALONE = 10
"""With so many presses the machine does nothing else."""

_WAITED_S = 3.0


@contextlib.contextmanager
def attacking(module: str, *arguments: str) -> Iterator[list[int]]:
    """The attack, for as long as the block; how often it was answered at the end."""
    command = [sys.executable, "-m", module, *arguments]
    answered: list[int] = []
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "attacking\n"
        try:
            yield answered
        finally:
            output, _ = process.communicate(timeout=PATIENCE_S)
            answered.append(int(output))


def pressed_ms(gateway: GatewayProcess, press: Callable[[], object]) -> float:
    """From the press until POWER_CUT of both was heard on the bus; infinite where it never was."""
    assert gateway.ask("mend") == "standby"
    cuts: dict[str, float] = {}
    begin_s = time.time()
    with contextlib.suppress(OSError):
        press()
    while len(cuts) < 2 and time.time() < begin_s + _WAITED_S:
        cuts |= gateway.ask("cuts")
    return 1000 * (max(cuts.values()) - begin_s) if len(cuts) == 2 else float("inf")


def judge(times_ms: list[float], before: dict[str, Any], after: dict[str, Any]) -> None:
    """Every stop is on the bus within the bound, and no tick is skipped between both counts.

    That is judged where VCU_PRESSES asks for 10, as `make nightly` does on a machine that does
    nothing else. Beside other tests ticks are skipped without any attack, and one stop of five may
    meet such a moment.
    """
    if PRESSES < _ALONE:
        assert sorted(times_ms)[-2] <= BOUND_MS, times_ms
    else:
        assert max(times_ms) <= BOUND_MS, times_ms
        assert after["skipped"] == before["skipped"], after["said"]


def kinds(all_kinds: Iterable[str], usual: Collection[str]) -> list[Any]:
    """Every kind of attack; the unusual ones are for the night, when nothing else takes time."""
    return [
        kind if kind in usual else pytest.param(kind, marks=pytest.mark.slow) for kind in all_kinds
    ]


def told(kind: str, times_ms: list[float]) -> str:
    """A line for the report."""
    ranked = sorted(times_ms)
    p50, p99 = ranked[len(ranked) // 2], ranked[int(0.99 * len(ranked))]
    return f"\n{kind}: press to POWER_CUT p50 {p50:.0f} ms, p99 {p99:.0f} ms of {len(ranked)}"
