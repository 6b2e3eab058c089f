"""Child process of the demo: gateway and simulated vehicle, seen from the parent."""

import json
import os
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import IO, NamedTuple, Self

from vcu_gateway.errors import GatewayError, Problem, UnavailableError

READY = "ready"
"""First line of the child."""
NOTE = "scenario, "
"""Beginning of a line that says which step of the scenario begins or ends."""

_PROGRAM = "vcu_gateway.demo.main"
_PATIENCE_S = 10.0


def default_socket() -> Path:
    """Where the API listens unless told otherwise: the same path every time, of this user."""
    own = os.environ.get("XDG_RUNTIME_DIR", "")
    if own and os.access(own, os.W_OK | os.X_OK):
        return Path(own, "vcu-gateway-demo.sock")
    return Path(tempfile.gettempdir(), f"vcu-gateway-demo-{os.geteuid()}.sock")


class DemoOptions(NamedTuple):
    """Options of the demo.

    Attributes:
        socket_path: where its API listens.
        throttle_pct: None is the configuration's, else 30.
        has_demand: False leaves the demand to another program.
        battery_speedup: factor of the battery's charge and discharge; None is the scenario's,
            else 20.
        duration_s: None is until its stdin ends.
        recorder_socket: of a recorder to hand over to; None: nothing is recorded.
        config_path, scenario_path: files; None: there is none.
    """

    interface: str
    channel: str
    socket_path: str
    throttle_pct: float | None = None
    has_demand: bool = True
    battery_speedup: float | None = None
    duration_s: float | None = None
    recorder_socket: str | None = None
    config_path: str | None = None
    scenario_path: str | None = None


class DemoProcess:
    """Child process, started at once and ended with the `with` block.

    Attributes:
        socket_path: where its API listens.
        notes: which steps of the scenario have begun and ended, so far.
        summary: its last line; empty before the end.
    """

    def __init__(self, wanted: DemoOptions) -> None:
        self.socket_path = Path(wanted.socket_path)
        self.notes: list[str] = []
        self.summary = ""
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 - closed in __exit__
        self._process = subprocess.Popen(  # noqa: S603 - our own program
            [sys.executable, "-P", "-m", _PROGRAM, json.dumps(wanted._asdict())],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,  # on the terminal it would spoil the picture
            text=True,
            start_new_session=True,  # Ctrl-C is for us; its stdin ends it
        )
        self._stdin, self._stdout = _pipes(self._process)
        self._ended = threading.Event()
        self._reader = threading.Thread(target=self._read, name="demo", daemon=True)
        started = self._stdout.readline().strip() == READY
        self._reader.start()
        if not started:
            self._end()
            raise self._failure()

    def _read(self) -> None:
        for line in self._stdout:
            if line.startswith(NOTE):
                self.notes.append(line.strip())
            else:
                self.summary = line.strip()
                self._ended.set()
        self._ended.set()

    def has_ended(self) -> bool:
        """True from its last line on: its duration is over, or it has failed."""
        return self._ended.is_set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._end()
        if kind is None and self._process.returncode != 0:
            raise self._failure()
        self._errors.close()

    def _end(self) -> None:
        self._stdin.close()
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._reader.join()
        self._stdout.close()

    def _failure(self) -> GatewayError:
        """Error with the lines and the exit code of the failed child."""
        with self._errors:
            self._errors.seek(0)
            lines = self._errors.read().splitlines()
        code = self._process.returncode
        problems = [line.removeprefix("error: ") for line in lines] or [f"it ended with {code}"]
        failure = UnavailableError(*map(Problem, problems))
        failure.exit_code = code if code > 0 else os.EX_SOFTWARE
        return failure


def _pipes(process: subprocess.Popen[str]) -> tuple[IO[str], IO[str]]:
    if process.stdin is None or process.stdout is None:
        raise AssertionError("both are pipes")
    return process.stdin, process.stdout
