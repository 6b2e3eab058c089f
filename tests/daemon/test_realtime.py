"""Locking memory, in a process of its own, whose limit is the test's; collecting garbage."""

import gc
import subprocess
import sys

from vcu_gateway.daemon import ticking_thread

TOLD = "print(next(line for line in open('/proc/self/status') if line.startswith('VmLck')))"


def locked(prepare: str = "") -> subprocess.CompletedProcess[str]:
    code = "from vcu_gateway.daemon import ticking_thread\n"
    code += f"{prepare}\nticking_thread.lock_memory()\n{TOLD}"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=30)


def test_memory_is_locked_or_the_limit_is_named():
    done = locked()
    if done.returncode == 0:
        assert int(done.stdout.split()[1]) > 1000  # kB
    else:
        assert "memory cannot be locked" in done.stderr


def test_without_the_right_to_it_the_limit_is_named():
    done = locked(
        "import os, resource\n"
        "resource.setrlimit(resource.RLIMIT_MEMLOCK, (0, 0))\n"
        "os.geteuid() or os.setuid(65534)"
    )
    assert done.returncode != 0
    assert "memory cannot be locked" in done.stderr
    assert "LimitMEMLOCK=" in done.stderr


def test_garbage_is_collected_once_a_minute_and_by_nothing_else():
    gc.enable()  # a verb that ran in this process leaves it disabled
    collected = []

    def note(phase: str, info: dict[str, int]) -> None:
        if phase == "stop":
            collected.append((index, info["generation"]))

    with ticking_thread.few_pauses():
        gc.callbacks.append(note)
        try:
            for index in range(2400):  # two minutes
                kept = [[] for _ in range(1000)]
                ticking_thread.collect_after(index)
                del kept
        finally:
            gc.callbacks.remove(note)
    assert collected == [(1199, 2), (2399, 2)]
    assert gc.isenabled()
