"""What locking the memory is worth when the machine has none left; `make nightly`."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.vcan.conftest import Process, Stand, wait_until

SECONDS = 10
LEAVE_MB = 20  # what is available beside the hog: less than the gateway's own pages
# Holds memory, and reads files again and again: the page cache churns.
HOG = """
import glob, os, sys, time
held = bytearray(int(sys.argv[1]) << 20)
end = time.monotonic() + float(sys.argv[2])
files = [name for name in glob.glob("/usr/lib/*/*.so*") if os.path.isfile(name)]
while time.monotonic() < end:
    held[::4096] = bytes(len(held[::4096]))
    for name in files:
        with open(name, "rb", buffering=0) as file:
            while time.monotonic() < end and file.read(1 << 20):
                pass
"""


def available_mb() -> int:
    lines = Path("/proc/meminfo").read_text().splitlines()
    return next(int(line.split()[1]) // 1024 for line in lines if line.startswith("MemAvailable"))


def faults_from_disk(process: Process) -> int:
    stat = Path(f"/proc/{process.popen.pid}/stat").read_text()
    return int(stat.rpartition(")")[2].split()[9])


def faults_under_pressure(stand: Stand, *options: str) -> int:
    """Pages that the running gateway had to fetch from the disk while memory was short."""
    gateway = stand.gateway("", *options)
    wait_until(lambda: gateway.has_logged("link_open"), "the first ticks")
    before = faults_from_disk(gateway)
    hold_mb = available_mb() - LEAVE_MB
    subprocess.run([sys.executable, "-I", "-S", "-c", HOG, str(hold_mb), str(SECONDS)], check=True)
    faults = faults_from_disk(gateway) - before
    assert gateway.stop() == 0
    return faults


@pytest.mark.slow
def test_a_locked_gateway_waits_for_no_page_when_memory_is_short(fresh_stand: Stand):
    ordinary = faults_under_pressure(fresh_stand)
    locked = faults_under_pressure(fresh_stand, "--lock-memory")
    print(f"pages fetched from the disk in {SECONDS} s: {ordinary} ordinary, {locked} locked")
    assert ordinary > 10, "the pressure was none"
    assert locked <= ordinary // 5
