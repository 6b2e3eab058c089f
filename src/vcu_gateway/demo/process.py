"""Child process of the demo: gateway and simulated vehicle, seen from the parent."""

import json
import os
import select
import subprocess
import sys
import tempfile
from pathlib import Path
from types import TracebackType
from typing import IO, NamedTuple, Self

from vcu_gateway.errors import GatewayError, Problem, UnavailableError

_PROGRAM = "vcu_gateway.demo.main"
_PATIENCE_S = 10.0


class DemoOptions(NamedTuple):
    """Options of the demo.

    Attributes:
        battery_speedup: factor of the battery's charge and discharge; 1 is real time.
        duration_s: None is until its stdin ends.
        recorder_socket: of a recorder to hand over to; None: nothing is recorded.
    """

    interface: str
    channel: str
    throttle_pct: float
    battery_speedup: float
    duration_s: float | None
    recorder_socket: str | None = None


class DemoProcess:
    """Child process, started at once and ended with the `with` block.

    Attributes:
        socket_path: where its API listens.
        summary: its last line; empty before the end.
    """

    def __init__(self, wanted: DemoOptions) -> None:
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
        first = self._stdout.readline().strip()
        self.socket_path = Path(first)
        if not first:
            self._end()
            raise self._failure()

    def has_ended(self) -> bool:
        """True from its last line on: its duration is over, or it has failed."""
        readable, _, _ = select.select([self._stdout], [], [], 0)
        return bool(readable)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end()
        if error is None and self._process.returncode != 0:
            raise self._failure()
        self._errors.close()

    def _end(self) -> None:
        self._stdin.close()
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self.summary = self._stdout.read().strip()
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
