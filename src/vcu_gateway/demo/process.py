"""Process of the demo's gateway: its configuration, its recorder, and what it says."""

import contextlib
import dataclasses
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any, NamedTuple, Self

from vcu_gateway import config as configuration
from vcu_gateway.config import BenchDemandSection, BenchSection, Config
from vcu_gateway.config.checks import check_protocol, load_protocol
from vcu_gateway.config.model import ApiSection
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.errors import ConfigError, GatewayError, Problem, UnavailableError
from vcu_gateway.protocol import packaged
from vcu_gateway.recording import layout
from vcu_gateway.recording.recorder_status import STATUS_PATH
from vcu_gateway.simulator import scenario
from vcu_gateway.simulator.pedals import Foot
from vcu_gateway.simulator.scenario import Scenario, ScenarioStart

_PATIENCE_S, _LOOK_EVERY_S = 10.0, 0.02


class _Child:
    """Process of this program, ended with the `with` block; what it says on stderr is kept."""

    def __init__(self, *arguments: str, **streams: Any) -> None:
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 - closed in __exit__
        self._process = subprocess.Popen(  # noqa: S603 - our own program
            [sys.executable, "-P", "-m", *arguments],
            stderr=self._errors,  # on the terminal it would spoil the picture
            start_new_session=True,  # Ctrl-C is for us
            **streams,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._end()
        if kind is None and self._process.returncode != 0:
            raise self._failure()
        self._errors.close()

    def _end(self) -> None:
        """Wait for its end, which has been asked for."""
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _failure(self) -> GatewayError:
        raise NotImplementedError

    def _last_words(self) -> list[str]:
        """What it said on stderr; else how it ended."""
        with self._errors:
            self._errors.seek(0)
            lines = self._errors.read().splitlines()
        ended = f"it ended with {self._process.returncode}"
        return [line.removeprefix("error: ") for line in lines] or [ended]


class DemoRecorder(_Child):
    """Recorder that writes into a folder, which is made where it is not there.

    Attributes:
        socket_path: where the demo's gateway hands over.
    """

    def __init__(self, folder: Path) -> None:
        """UnavailableError, with the recorder's own words, where it cannot write there."""
        self.folder = folder
        self._place = tempfile.TemporaryDirectory(prefix="vcu-gateway-demo.")
        self.socket_path = Path(self._place.name, "tap.sock")
        self._status_path = folder / STATUS_PATH.name  # where `recordings keep now` looks
        options = ["--folder", folder, "--socket", self.socket_path, "--keep-free-bytes", "0"]
        options += ["--status", self._status_path]
        super().__init__("vcu_gateway", "recorder", *map(str, options), stdin=subprocess.DEVNULL)
        self._wait_for_the_socket()
        self._before = set(self._drives())

    def _wait_for_the_socket(self) -> None:
        until_s = time.monotonic() + _PATIENCE_S
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

    def _end(self) -> None:
        self._process.send_signal(signal.SIGTERM)
        super()._end()
        with contextlib.suppress(OSError):
            self._status_path.unlink()
        self._place.cleanup()

    def _failure(self) -> GatewayError:
        return UnavailableError(Problem(f"the demo's recorder: {self._last_words()[-1]}"))


READY = "ready"
"""First line of the child."""
NOTE = "scenario, "
"""Beginning of a line that says which step of the scenario begins or ends."""


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
        throttle_pct: None is the configuration's, else 30; with pedals travel of the foot.
        has_demand: False leaves the demand to another program.
        battery_speedup: factor of the battery's charge and discharge; None is the scenario's,
            else 20.
        duration_s: None is until its stdin ends.
        recorder_socket: of a recorder to hand over to; None: nothing is recorded.
        config_path, scenario_path: files; None: there is none.
        has_pedals: a pedal node drives; without a configuration that of the example.
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
    has_pedals: bool = False


class DemoProcess(_Child):
    """Gateway and simulated vehicle, started at once.

    Attributes:
        socket_path: where its API listens.
        notes: which steps of the scenario have begun and ended, so far.
        summary: its last line; empty before the end.
    """

    def __init__(self, wanted: DemoOptions) -> None:
        self.socket_path = Path(wanted.socket_path)
        self.notes: list[str] = []
        self.summary = ""
        wanted_json, pipe = json.dumps(wanted._asdict()), subprocess.PIPE
        super().__init__("vcu_gateway.demo.main", wanted_json, stdin=pipe, stdout=pipe, text=True)
        if self._process.stdin is None or self._process.stdout is None:
            raise AssertionError("both are pipes")
        self._stdin, self._stdout = self._process.stdin, self._process.stdout
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

    def _end(self) -> None:
        self._stdin.close()  # it ends with it
        super()._end()
        self._reader.join()
        self._stdout.close()

    def _failure(self) -> GatewayError:
        """Error with the lines and the exit code of the failed child."""
        failure = UnavailableError(*map(Problem, self._last_words()))
        code = self._process.returncode
        failure.exit_code = code if code > 0 else os.EX_SOFTWARE
        return failure


_THROTTLE_PCT = 30.0
_ROUND_S, _ROUNDS = 30.0, 120  # an hour
_RELEASED_S = 5.0  # of each round: time to arm
_BATTERY_SPEEDUP = 20.0  # a person waits, and wants to see it drain


def load(wanted: DemoOptions) -> tuple[Config, ProtocolSpec, Scenario]:
    """Read the files and put the demo together; GatewayError names everything wrong in them."""
    config = _config(wanted)
    protocol = load_protocol(config)
    check_protocol(config, protocol)
    if problems := configuration.check_against(config, protocol):
        raise ConfigError(*problems)
    return config, protocol, _scenario(wanted, config, protocol)


def _config(wanted: DemoOptions) -> Config:
    """All that the file says, but for the bus, the sockets and who may use them."""
    file = _file(wanted)
    bus = {"interface": wanted.interface, "channel": wanted.channel}
    api = {"socket_path": wanted.socket_path, "socket_mode": "0600"}
    recorder = {"socket_path": wanted.recorder_socket}
    return file.model_copy(
        update={
            "bus": file.bus.model_copy(update=bus),
            "api": ApiSection().model_copy(update=api),
            "recorder": file.recorder.model_copy(update=recorder),
            "bench": _bench(wanted, file),
        }
    )


def _file(wanted: DemoOptions) -> Config:
    path = None if wanted.config_path is None else Path(wanted.config_path)
    if wanted.has_pedals and path is None:
        return configuration.load(packaged("pedals.yaml"))
    file = configuration.of_values({}, "demo") if path is None else configuration.load(path)
    if wanted.has_pedals and file.pedals.can is None:
        remedy = "config/examples/pedals.yaml has some; without -c they are those"
        raise ConfigError(Problem("has no pedals.can, and --pedals needs it", str(path), remedy))
    return file


def _bench(wanted: DemoOptions, file: Config) -> BenchSection:
    """The file's demand where it has one, with another throttle where that was asked for."""
    bench, throttle_pct = file.bench, wanted.throttle_pct
    if not wanted.has_demand or file.pedals.can is not None:
        return bench.model_copy(update={"demand": None})
    demand = bench.demand
    if demand is None:
        demand = BenchDemandSection(
            bench_use_only=True,
            throttle_pct=_THROTTLE_PCT,
            power_mode="normal",
            speed_limit_rpm=file.limits.speed_limit_max_rpm,
        )
        bench = bench.model_copy(update={"auto_arm": True})
    if throttle_pct is not None:
        demand = demand.model_copy(update={"throttle_pct": throttle_pct})
    return bench.model_copy(update={"demand": demand})


def _scenario(wanted: DemoOptions, config: Config, protocol: ProtocolSpec) -> Scenario:
    """The file's; the options win over its battery_speedup and its foot."""
    path, speedup = wanted.scenario_path, wanted.battery_speedup
    found = Scenario(ScenarioStart(battery_speedup=_BATTERY_SPEEDUP), ())
    if path is not None:
        found = scenario.load(Path(path), protocol)
        found.check_pedals(config.pedals.can is not None, str(Path(path)))
    drives = config.pedals.can is not None and wanted.has_demand
    if drives and (found.foot is None or wanted.throttle_pct is not None):
        throttle_pct = _THROTTLE_PCT if wanted.throttle_pct is None else wanted.throttle_pct
        found = dataclasses.replace(found, foot=_foot(throttle_pct))
    if speedup is None:
        return found
    start = found.start.model_copy(update={"battery_speedup": speedup})
    return dataclasses.replace(found, start=start)


def _foot(throttle_pct: float) -> Foot:
    """It lets go again and again: where the first time was too early to arm, the next will do."""
    points = []
    for number in range(_ROUNDS):
        begin_s = number * _ROUND_S
        points += [(begin_s + _RELEASED_S, 0.0), (begin_s + _RELEASED_S + 1, throttle_pct)]
        points += [(begin_s + _ROUND_S - 1, throttle_pct), (begin_s + _ROUND_S, 0.0)]
    return Foot(Curve(tuple(points[:-1])))  # after the last round it stays pressed
