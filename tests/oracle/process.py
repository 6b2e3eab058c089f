"""The real gateway, started as a person starts it, with a configuration written by hand."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

from tests.oracle.api import Client, RefusedError
from tests.oracle.wire import CHANNEL

PATIENCE_S = 40.0


def _yaml(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_yaml(one)}" for key, one in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_yaml, value)) + "]"
    return str(value)


def configuration(folder: Path, sections: dict[str, dict]) -> str:
    """YAML text: the bus, the API in the folder, and what differs from the defaults."""
    merged: dict[str, dict] = {
        "bus": {"channel": CHANNEL},
        "api": {"socket_path": folder / "control.sock"},
        "log": {"format": "json"},
    }
    for section, keys in sections.items():
        merged.setdefault(section, {}).update(keys)
    lines = []
    for section, keys in merged.items():
        lines.append(f"{section}:")
        lines += [f"  {key}: {_yaml(value)}" for key, value in keys.items()]
    return "\n".join(lines) + "\n"


class Gateway:
    def __init__(self, folder: Path, sections: dict[str, dict] | None = None) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.file = folder / "gateway.yaml"
        self.log = folder / "log.jsonl"
        self.runtime = folder / "runtime"
        self.runtime.mkdir(exist_ok=True)
        self.configure(sections or {})
        self.process: subprocess.Popen | None = None

    def configure(self, sections: dict[str, dict]) -> None:
        self.sections = sections
        self.file.write_text(configuration(self.folder, sections))

    def start(self) -> None:
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "vcu_gateway", "run", "-c", str(self.file)],
                env={**os.environ, "RUNTIME_DIRECTORY": str(self.runtime)},
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
            )

    def client(self) -> Client:
        """A connection, once the gateway has ticked."""
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                client = Client(str(self.folder / "control.sock"))
                client.call("why")
            except (OSError, RefusedError):
                self.must_run()
                assert time.monotonic() < deadline, f"no API in {PATIENCE_S} s\n{self.told()}"
                time.sleep(0.02)
            else:
                return client

    def must_run(self) -> None:
        assert self.process is not None
        code = self.process.poll()
        assert code is None, f"the gateway ended with {code}\n{self.told()}"

    def told(self) -> str:
        return self.log.read_text(errors="replace")[-3000:] if self.log.exists() else ""

    @property
    def runs(self) -> bool:
        return self.process is not None and self.process.poll() is None

    def signal(self, number: int) -> None:
        assert self.process is not None
        self.process.send_signal(number)

    def kill(self) -> None:
        """As a crash: nothing is said, nothing is tidied."""
        if self.runs:
            self.signal(signal.SIGKILL)
            self.wait()

    def terminate(self) -> int:
        self.signal(signal.SIGTERM)
        return self.wait()

    def wait(self) -> int:
        assert self.process is not None
        return self.process.wait(PATIENCE_S)

    def end(self) -> None:
        if self.runs:
            with contextlib.suppress(ProcessLookupError):
                self.signal(signal.SIGCONT)
            self.kill()
        (self.folder / "control.sock").unlink(missing_ok=True)
