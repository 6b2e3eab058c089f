"""A real vcan0, the real program, and a recorder that is a process of its own."""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import pytest

from tests.unrecorded import unrecorded

# Imported for the processes that are forked from this one.
from vcu_gateway import cli
from vcu_gateway.cli import run, simulate  # noqa: F401

HERE = Path(__file__).parent
CHANNEL = "vcan0"
# Only for what hangs. Under QEMU the guest's clock leaps while it waits for the machine's files.
PATIENCE_S = 400.0 if os.environ.get("VCU_LAB") == "qemu" else 40.0
EXTENDED = 0b100
COMMANDS = (0x0008A7D0, 0x0008A8D0)


def can_is_missing() -> str | None:
    """Why this machine cannot run these tests, or None."""
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
            bus.bind((CHANNEL,))
    except (OSError, AttributeError) as error:
        return f"no {CHANNEL} here: {error}; `make test-bus` runs these in the lab"
    return None


@pytest.fixture(scope="session", autouse=True)
def a_real_vcan0():
    why = can_is_missing()
    if why and (os.environ.get("CI") or os.environ.get("VCU_REQUIRE_CAN")):
        pytest.exit(why, returncode=1)
    if why:
        pytest.skip(why)


class Recorded(NamedTuple):
    """One frame as the recorder's socket saw it: kernel stamp, wall clock."""

    stamp_ns: int
    flags: int
    can_id: int
    data: bytes


class Forked(ForkProcess):
    """The program in a process of its own that need not import it first: 2 s in the lab."""

    def __init__(
        self, arguments: list[str], stdout: int, stderr: int, environment: dict[str, str]
    ) -> None:
        super().__init__(daemon=True)
        self._arguments, self._to, self._environment = arguments, (stdout, stderr), environment

    def run(self) -> None:
        os.environ.update(self._environment)
        for number, to in enumerate(self._to, start=1):
            os.dup2(to, number)
        sys.stdout = open(1, "w", buffering=1, closefd=False)  # noqa: SIM115
        sys.stderr = open(2, "w", buffering=1, closefd=False)  # noqa: SIM115
        sys.argv = ["vcu-gateway", *self._arguments]
        cli.main()

    def poll(self) -> int | None:
        return self.exitcode

    def wait(self, timeout: float) -> int:
        self.join(timeout)
        if self.exitcode is None:
            raise subprocess.TimeoutExpired(self._arguments, timeout)
        return self.exitcode

    def send_signal(self, number: int) -> None:
        os.kill(self.pid or 0, number)


@dataclass
class Process:
    """A child with its output in files, so that no full pipe ever stops it."""

    popen: subprocess.Popen[bytes] | Forked
    out: Path
    err: Path

    def stop(self, number: int = signal.SIGTERM, patience_s: float = PATIENCE_S) -> int:
        if self.popen.poll() is None:
            self.popen.send_signal(number)
        return self.popen.wait(patience_s)

    def log(self) -> list[dict[str, object]]:
        """Every whole line; the last one may be half written."""
        lines = self.err.read_text().rpartition("\n")[0].splitlines()
        return [json.loads(line) for line in lines if line.startswith("{")]

    def has_logged(self, event: str) -> bool:
        return any(entry["event"] == event for entry in self.log())

    def logged(self, event: str) -> dict[str, Any]:
        return next(entry for entry in self.log() if entry["event"] == event)


@dataclass
class Stand:
    """Starts processes on the bus and ends them with the test.

    Attributes:
        api: further keys of the gateway's `api` section, as in ", socket_mode: '0666'".
        wire: the interface of vehicle and recorder; the gateway's channel where it is empty.
        runtime: what a gateway's $RUNTIME_DIRECTORY is; one of its own for each where it is None,
            so that none begins with the CUT that another one has latched.
    """

    folder: Path
    channel: str = CHANNEL
    forking: bool = False
    children: list[Process] = field(default_factory=list)
    workers: list[ForkProcess] = field(default_factory=list)
    api: str = ""
    wire: str = ""
    runtime: Path | None = None

    def start(self, name: str, *command: str) -> Process:
        out, err = self.folder / f"{name}.out", self.folder / f"{name}.err"
        popen: subprocess.Popen[bytes] | Forked
        environment = {"RUNTIME_DIRECTORY": str(self._runtime_folder())}
        with out.open("wb") as stdout, err.open("wb") as stderr:
            if self.forking and list(command[:3]) == program():
                arguments = list(command[3:])
                popen = Forked(arguments, stdout.fileno(), stderr.fileno(), environment)
                popen.start()
            else:
                popen = subprocess.Popen(
                    command,
                    stdout=stdout,
                    stderr=stderr,
                    stdin=subprocess.DEVNULL,
                    env={**os.environ, **environment},
                )
        child = Process(popen, out, err)
        self.children.append(child)
        return child

    def _runtime_folder(self) -> Path:
        folder = self.runtime or self.folder / f"runtime-{len(self.children)}"
        folder.mkdir(exist_ok=True)
        return folder

    def gateway(self, config: str = "", *options: str) -> Process:
        """`vcu-gateway run` on the channel with this text added to the configuration."""
        self.configure(config)
        return self.start("gateway", *program("run", "-c", str(self.config_path), *options))

    @property
    def config_path(self) -> Path:
        return self.folder / "gateway.yaml"

    @property
    def socket_path(self) -> Path:
        """Of the gateway's API."""
        return self.folder / "control.sock"

    def configure(self, config: str) -> None:
        """Write the gateway's configuration: the channel, the API's socket and this text."""
        api = f"api: {{socket_path: {self.socket_path}{self.api}}}"
        text = f"bus: {{channel: {self.channel}}}\n{api}\n{config}"
        self.config_path.write_text(unrecorded(self.folder, text))

    def run(self, work: Callable[[], None]) -> ForkProcess:
        """This function in a process of its own."""
        child = ForkProcess(target=work, daemon=True)
        child.start()
        self.workers.append(child)
        return child

    def held(self, work: Callable[[], None]) -> Callable[[], None]:
        """The same, begun by calling what is returned; the process is there already.

        Forking takes the lab's one processor for 100 ms and more: not while something is measured.
        """
        (is_there, there), (may_begin, begin) = os.pipe(), os.pipe()

        def waits() -> None:
            os.write(there, b"1")
            os.read(may_begin, 1)
            work()

        self.run(waits)
        os.read(is_there, 1)
        for end in (is_there, there, may_begin):
            os.close(end)

        def go() -> None:
            os.write(begin, b"1")
            os.close(begin)

        return go

    def record(self) -> "Recording":
        path = self.folder / "recording"
        child = self.start(
            "recorder",
            *(sys.executable, str(HERE / "recorder.py"), str(path), self.wire or self.channel),
        )
        wait_until(lambda: child.out.read_text() == "ready\n", "the recorder")
        return Recording(child, path)

    def replay(self, log: Path) -> Process:
        script = str(HERE / "replay.py")
        return self.start("replay", sys.executable, script, self.channel, str(log))

    def vehicle(self, scenario: str = "") -> Process:
        """`vcu-gateway simulate` on the wire, broken by this scenario."""
        options = ["--channel", self.wire or self.channel]
        if scenario:
            path = self.folder / "scenario.yaml"
            path.write_text(scenario)
            options += ["--scenario", str(path)]
        return self.start("vehicle", *program("simulate", *options))


def _parsed(line: str) -> Recorded:
    stamp, can_id, data = line.split(",")
    flagged = int(can_id, 16)
    return Recorded(int(stamp), flagged >> 29, flagged & 0x1FFF_FFFF, bytes.fromhex(data))


@dataclass
class Recording:
    process: Process
    path: Path

    _read_to: int = 0
    _frames: list[Recorded] = field(default_factory=list)

    def frames(self) -> list[Recorded]:
        """Everything recorded so far; only what is new is read, polling must stay cheap."""
        with self.path.open("rb") as recorded:
            recorded.seek(self._read_to)
            whole_lines = recorded.read().rpartition(b"\n")[0]
        if whole_lines:
            self._read_to += len(whole_lines) + 1
            self._frames += map(_parsed, whole_lines.decode().splitlines())
        return list(self._frames)

    def commands(self) -> list[Recorded]:
        return [f for f in self.frames() if f.flags == EXTENDED and f.can_id in COMMANDS]

    def wait_for(self, condition: Callable[[list[Recorded]], bool], what: str) -> list[Recorded]:
        wait_until(lambda: condition(self.frames()), what)
        return self.frames()


def ip(*arguments: str) -> None:
    """Configure interfaces, as root or through sudo."""
    sudo = [] if os.geteuid() == 0 else ["sudo"]
    subprocess.run([*sudo, "ip", *arguments], check=True)


def program(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "vcu_gateway", *arguments]


def wait_until(condition: Callable[[], bool], what: str, patience_s: float = PATIENCE_S) -> None:
    """Poll until true; the test fails, saying what was waited for, after patience_s."""
    deadline = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline, f"waited {patience_s} s in vain for {what}"
        time.sleep(0.05)


StandType = TypeVar("StandType", bound=Stand)


@contextlib.contextmanager
def ended_after(stand: StandType) -> Iterator[StandType]:
    """A stand whose children do not outlive the block."""
    try:
        yield stand
    finally:
        for worker in stand.workers:
            worker.kill()
            worker.join(PATIENCE_S)
        for child in stand.children:
            if child.popen.poll() is None:
                child.popen.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.popen.wait(PATIENCE_S)


FIGURES = pytest.StashKey[list[str]]()


@pytest.fixture
def figures(request: pytest.FixtureRequest) -> list[str]:
    """Lines that are printed at the end of the run, passed or not."""
    return request.config.stash.setdefault(FIGURES, [])


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    if lines := config.stash.get(FIGURES, []):
        terminalreporter.section("measured on the bus")
        for line in lines:
            terminalreporter.line(line)


@pytest.fixture
def stand(tmp_path: Path) -> Iterator[Stand]:
    """Programs are forked from this process: imported once, everything else their own."""
    with ended_after(Stand(tmp_path, forking=True)) as stand:
        yield stand


@pytest.fixture
def fresh_stand(tmp_path: Path) -> Iterator[Stand]:
    """Programs are started as a person starts them."""
    with ended_after(Stand(tmp_path)) as stand:
        yield stand
