"""What the kernel says of a process, and the program run as a process of its own."""

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from tests.driven import wait_until
from tests.faults.line_client import LineClient

PATIENCE_S = 20.0


def resident_kb(pid: int | str = "self") -> int:
    """Memory in use now."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") // 1024


def descriptors(pid: int | str = "self") -> list[str]:
    """What each open descriptor leads to."""
    folder = Path(f"/proc/{pid}/fd")
    found = []
    for one in folder.iterdir():
        with contextlib.suppress(OSError):
            found.append(os.readlink(one))
    return found


class Program:
    """`vcu-gateway run` on a virtual bus of its own, with its API."""

    def __init__(self, folder: Path, config: str, process: "subprocess.Popen[bytes]") -> None:
        self.folder = folder
        self.process = process
        self._config = config

    @property
    def socket_path(self) -> Path:
        return self.folder / "control.sock"

    def until_serving(self) -> None:
        wait_until(self._serves, "the API", PATIENCE_S)

    def _serves(self) -> bool:
        assert self.process.poll() is None, f"it ended with {self.process.returncode}"
        try:
            with LineClient(self.socket_path) as client:
                return "result" in client.request("why")
        except (OSError, json.JSONDecodeError):
            return False

    def health(self) -> dict[str, Any]:
        with LineClient(self.socket_path) as client:
            result: dict[str, Any] = client.result("health")
        return result

    def end(self, number: int = signal.SIGTERM) -> float:
        """Ask it to end in order; how long that took, s."""
        begun_s = time.monotonic()
        self.process.send_signal(number)
        assert self.process.wait(PATIENCE_S) == 0
        return time.monotonic() - begun_s


@contextlib.contextmanager
def program(
    folder: Path,
    config: str = "",
    *options: str,
    stdout: int | None = subprocess.DEVNULL,
    stderr: int | None = subprocess.DEVNULL,
    before: Callable[[], None] | None = None,
    env: dict[str, str] | None = None,
) -> Iterator[Program]:
    """The program, killed at the end where it still runs; `before` is called in the child."""
    path = folder / "gateway.yaml"
    path.write_text(
        "bus: {interface: virtual, channel: alone}\n"
        f"api: {{socket_path: {folder / 'control.sock'}}}\n{config}"
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "vcu_gateway", "run", "-c", str(path), *options],
        stdin=subprocess.DEVNULL,
        stdout=stdout,
        stderr=stderr,
        preexec_fn=before,  # noqa: PLW1509 - it only closes and limits
        env={**os.environ, **(env or {})},
    )
    try:
        yield Program(folder, config, process)
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
