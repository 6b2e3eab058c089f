"""A guest's power cut: its disk outlives it, its memory does not."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.lab.powered import LAB, Powered, afterwards, make_disk

pytestmark = pytest.mark.skipif("VCU_LAB" in os.environ, reason="inside the lab already")

# Two files get the same lines; one of them is synced, every tenth time.
WRITE = """
import os, time
files = [open(f"/mnt/{name}", "ab", buffering=0) for name in ("synced", "not-synced")]
os.fsync(os.open("/mnt", os.O_RDONLY))
for number in range(100_000):
    for file in files:
        file.write(b"%d\\n" % number)
    if number % 10 == 0:
        os.fdatasync(files[0])
        print("synced", number, flush=True)
    time.sleep(0.002)
"""


@pytest.fixture(scope="module")
def disk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a guest whose power was cut left behind: in `told` what it said was synced."""
    disk = make_disk(tmp_path_factory.mktemp("disk") / "disk.img")
    guest = Powered(disk, sys.executable, "-I", "-c", WRITE)
    guest.until("synced 100")
    told = [line for line in guest.cut() if line.startswith("synced")]
    disk.with_name("told").write_text(told[-1].split()[1])
    return disk


def test_what_was_synced_before_a_power_cut_is_read_after_it(disk: Path) -> None:
    told = int(disk.with_name("told").read_text())
    numbers = afterwards(disk, "cat", "/mnt/synced").split()
    assert numbers[: told + 1] == [str(number) for number in range(told + 1)]


def test_what_was_not_synced_before_a_power_cut_is_lost(disk: Path) -> None:
    assert afterwards(disk, "cat", "/mnt/not-synced") == ""


def test_a_disk_that_is_no_file_is_refused(tmp_path: Path) -> None:
    argv = [str(LAB), "run", "--disk", str(tmp_path / "none"), "--", "true"]
    done = subprocess.run(argv, capture_output=True, text=True)
    assert done.returncode == 2
    assert "none: no file" in done.stderr
