"""Recorder of the demo, a process beside it; ended with the `with` block."""

import contextlib
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Self

from vcu_gateway.errors import GatewayError, Problem, UnavailableError
from vcu_gateway.recording import layout
from vcu_gateway.recording.recorder_status import STATUS_PATH

_START_S = 10.0
_END_S = 10.0
_LOOK_EVERY_S = 0.02


class DemoRecorder:
    """Recorder that writes into a folder, which is made where it is not there.

    Attributes:
        socket_path: where the demo's gateway hands over.
    """

    def __init__(self, folder: Path) -> None:
        """UnavailableError, with the recorder's own words, where it cannot write there."""
        self.folder = folder
        self._place = tempfile.TemporaryDirectory(prefix="vcu-gateway-demo.")
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 - closed in __exit__
        self.socket_path = Path(self._place.name, "tap.sock")
        self._status_path = folder / STATUS_PATH.name  # where `recordings keep now` looks
        options = ["--folder", folder, "--socket", self.socket_path, "--keep-free-bytes", "0"]
        options += ["--status", self._status_path]
        self._process = subprocess.Popen(  # noqa: S603 - our own program
            [sys.executable, "-P", "-m", "vcu_gateway", "recorder", *map(str, options)],
            stdin=subprocess.DEVNULL,
            stderr=self._errors,  # on the terminal it would spoil the picture
            start_new_session=True,  # Ctrl-C is for us
        )
        self._wait_for_the_socket()
        self._before = set(self._drives())

    def _wait_for_the_socket(self) -> None:
        until_s = time.monotonic() + _START_S
        while not self.socket_path.exists():
            if self._process.poll() is not None or time.monotonic() > until_s:
                self._end()
                raise self._failure()
            time.sleep(_LOOK_EVERY_S)

    @property
    def drive(self) -> Path | None:
        """The drive that was recorded; None before there is one."""
        return max(set(self._drives()) - self._before, default=None)

    def _drives(self) -> list[Path]:
        return layout.recorded_folders(self.folder / layout.DRIVES)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._end()
        if kind is None and self._process.returncode != 0:
            raise self._failure()
        self._errors.close()

    def _end(self) -> None:
        self._process.send_signal(signal.SIGTERM)
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        with contextlib.suppress(OSError):
            self._status_path.unlink()
        self._place.cleanup()

    def _failure(self) -> GatewayError:
        with self._errors:
            self._errors.seek(0)
            lines = self._errors.read().splitlines()
        ended = f"it ended with {self._process.returncode}"
        said = lines[-1].removeprefix("error: ") if lines else ended
        return UnavailableError(Problem(f"the demo's recorder: {said}"))
