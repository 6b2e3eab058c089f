"""A guest with a disk whose power a test cuts, and the same disk in the next guest."""

import os
import shlex
import signal
import subprocess
import time
from pathlib import Path

LAB = Path(__file__).with_name("lab")
# Only for a lab that hangs; a busy machine takes its time.
PATIENCE_S = 300
MOUNTED = "/mnt"
# What nobody asked to be written stays in the guest's memory, and is lost with it: without this
# the kernel writes it back sooner or later, and a cut would say less than it seems to.
MOUNT = f"echo 0 >/proc/sys/vm/dirty_writeback_centisecs; mount -t ext4 $VCU_DISK {MOUNTED}"


def make_disk(path: Path, size_mib: int = 64) -> Path:
    """An empty ext4 in a file, whose data is written with its own journal's transactions."""
    with path.open("wb") as file:
        file.truncate(size_mib << 20)
    environment = {**os.environ, "PATH": f"{os.environ['PATH']}:/usr/sbin:/sbin"}
    subprocess.run(["mkfs.ext4", "-q", "-F", str(path)], check=True, env=environment)
    return path


class Powered:
    """A command in a guest with this disk on /mnt; its output, line by line, as it comes.

    Attributes:
        disk: the file.
        lines: what it printed so far.
    """

    def __init__(self, disk: Path, *command: str, options: tuple[str, ...] = ()) -> None:
        self.disk = disk
        self.lines: list[str] = []
        script = f"{MOUNT} && exec {shlex.join(command)}"
        lab = [str(LAB), "run", "--timeout", str(PATIENCE_S), "--disk", str(disk), *options]
        self._process = subprocess.Popen(
            [*lab, "--", "sh", "-c", script], stdout=subprocess.PIPE, text=True
        )

    def until(self, text: str) -> str:
        """The next line that begins so."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.lines.append(line.rstrip("\n"))
            if line.startswith(text):
                return self.lines[-1]
        raise AssertionError(f"it ended with {self._process.wait()} before {text!r}: {self.lines}")

    def run_for(self, seconds: float) -> None:
        time.sleep(seconds)

    def cut(self) -> list[str]:
        """Cut the power; all lines that it printed until then."""
        self._process.send_signal(signal.SIGQUIT)
        assert self._process.stdout is not None
        self.lines += self._process.stdout.read().splitlines()
        assert self._process.wait() == 128 + signal.SIGQUIT
        return self.lines


def afterwards(disk: Path, *command: str) -> str:
    """What a command prints in the next guest, with the disk mounted again."""
    script = f"{MOUNT} && {shlex.join(command)}; status=$?; umount {MOUNTED}; exit $status"
    argv = [
        str(LAB),
        "run",
        "--timeout",
        str(PATIENCE_S),
        "--disk",
        str(disk),
        "--",
        "sh",
        "-c",
        script,
    ]
    done = subprocess.run(argv, capture_output=True, text=True)
    assert done.returncode == 0, f"{done.stdout}{done.stderr}"
    return done.stdout
