"""The API on a real bus: the dead-man, arbitration, rights and reload.

By the kernel's stamps of a recorder that is a process of its own.
"""

import contextlib
import functools
import itertools
import json
import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.context import ForkProcess
from pathlib import Path
from typing import Any, TextIO, TypeVar

import pytest

from tests.faults import reference_ticks
from tests.vcan.conftest import (
    COMMANDS,
    PATIENCE_S,
    Process,
    Recorded,
    Recording,
    Stand,
    ended_after,
    wait_until,
)
from vcu_gateway.client import Client, ConfigRefusedError, NoRightError, RefusedError

MS = 1_000_000
PERIOD_MS = 50
LEEWAY_MS = 5
TTL_MS = 200
NOBODY = 65534
SEQUENCES = itertools.count(1)  # of raw demands
THROTTLE_RAW = 51  # 20 %
QUIET = "steps:\n  - {at_s: 0, fault: silence, of: IMU}\n"


@dataclass
class Drive:
    """A gateway in standby, a healthy vehicle and a recorder."""

    stand: Stand
    recording: Recording
    gateway: Process

    @property
    def client(self) -> Client:
        return Client(self.stand.socket_path, timeout_s=PATIENCE_S)

    def until_ready(self) -> None:
        with self.client as client:
            wait_until(lambda: _ready(client), f"standby; the gateway: {self.gateway.err}")

    def owner(self, throttle_pct: float = 20.0, ttl_ms: int = 1000) -> ForkProcess:
        """A process that arms and drives until it is stopped, again where a stall ended it."""
        work = functools.partial(own, self.stand.socket_path, throttle_pct, ttl_ms)
        return self.stand.run(work)

    def until_driving(self) -> None:
        wait_until(lambda: self.last_throttle() >= THROTTLE_RAW, "throttle on the bus")

    def skipped(self) -> int:
        """Ticks that the gateway missed so far."""
        with self.client as client:
            return client.health()["ticks"]["skipped"]

    def last_throttle(self) -> int:
        commands = self.recording.commands()
        return commands[-1].data[1] if commands else 0

    def commands_when(
        self, at_ns: int, what: str, are_there: Callable[[list[Recorded]], bool]
    ) -> list[Recorded]:
        """The command frames after that moment, as soon as they are what is waited for."""
        found: list[Recorded] = []

        def look() -> bool:
            found[:] = [frame for frame in self.recording.commands() if frame.stamp_ns > at_ns]
            return are_there(found)

        wait_until(look, what)
        return found

    def commands_since(self, at_ns: int, count: int) -> list[Recorded]:
        """The command frames after that moment, at least so many."""
        return self.commands_when(at_ns, f"{count} commands", lambda found: len(found) >= count)

    def until_let_go(self, at_ns: int) -> None:
        """Until, after that moment, the last ten commands had no throttle."""

        def has_let_go(found: list[Recorded]) -> bool:
            return len(found) >= 10 and not any(frame.data[1] for frame in found[-10:])

        self.commands_when(at_ns, "ten commands without throttle", has_let_go)


def _ready(client: Client) -> bool:
    try:
        why = client.why()
    except Exception:  # noqa: BLE001 - not there yet
        return False
    return why["mode"] == "standby" and not why["blocks"]


def own(path: Path, throttle_pct: float, ttl_ms: int) -> None:
    with (
        Client(path, timeout_s=PATIENCE_S) as client,
        client.demand("driver", ttl_ms=ttl_ms, hold_s=None) as owner,
    ):
        while True:
            mode = client.why()["mode"]
            asked_pct = throttle_pct if mode == "active" else 0
            with contextlib.suppress(RefusedError):
                owner.set(throttle_pct=asked_pct, power_mode="normal")
                if mode == "fault":
                    client.reset()
                if mode == "standby":
                    client.arm()
            time.sleep(0.05)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Drive]:
    with ended_after(Stand(tmp_path_factory.mktemp("drive"), forking=True)) as stand:
        yield begin(stand)


@pytest.fixture
def drive(shared: Drive) -> Iterator[Drive]:
    """Nobody owns the demand, and the vehicle is not driven."""
    yield shared
    for worker in shared.stand.workers:
        worker.kill()
        worker.join(PATIENCE_S)
    shared.stand.workers.clear()
    with shared.client as client:
        wait_until(lambda: _let_go(client), "nobody's demand")


def _let_go(client: Client) -> bool:
    client.disarm()
    why = client.why()
    return why["mode"] != "active" and not (why["demand"] and why["demand"]["fresh"])


DriveT = TypeVar("DriveT", bound=Drive)


def begin(
    stand: Stand,
    config: str = "",
    scenario: str = QUIET,
    kind: type[DriveT] = Drive,  # type: ignore[assignment]
) -> DriveT:
    """A drive of this kind, in standby."""
    one = begin_alone(stand, config, kind)
    stand.vehicle(scenario)
    one.until_ready()
    return one


def begin_alone(stand: Stand, config: str, kind: type[DriveT]) -> DriveT:
    """The same without a vehicle."""
    recording = stand.record()
    gateway = stand.gateway(config)
    wait_until(lambda: gateway.has_logged("link_open"), "the gateway")
    return kind(stand, recording, gateway)


def let_go_ms(drive: Drive, at_ns: int) -> float:
    """From `at_ns` to the last throttle of either controller; zero torque follows."""
    drive.until_let_go(at_ns)
    last_ns = max(frame.stamp_ns for frame in drive.recording.commands() if frame.data[1] > 0)
    return (last_ns - at_ns) / MS


# Before the one that all others share: one gateway is on the bus at a time.
def test_another_user_may_read_and_stop_and_nothing_else(stand: Stand):
    stand.api = ", socket_mode: '0666'"
    open_to_all(stand.folder)
    drive = begin(stand)
    stranger = stand.run(functools.partial(be_a_stranger, stand.socket_path))
    stranger.join(PATIENCE_S)
    assert stranger.exitcode == 0
    tried = {"arm", "reset", "config.reload", "demand.set"}
    wait_until(lambda: {entry["method"] for entry in refusals(drive)} >= tried, "all in the log")
    who = {(entry["uid"], entry["pid"]) for entry in refusals(drive)}
    assert who == {(NOBODY, stranger.pid)}


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=lambda one: one.name)
def test_the_throttle_ends_within_the_time_to_live_when_its_owner_is_killed_or_stopped(
    drive: Drive, figures: list[str], number: signal.Signals
):
    def found_ms() -> float:
        owner = drive.owner(ttl_ms=TTL_MS)
        drive.until_driving()
        os.kill(owner.pid or 0, number)
        found_ms = let_go_ms(drive, time.time_ns())
        owner.kill()
        owner.join()
        return found_ms

    told = within(drive, TTL_MS + PERIOD_MS + LEEWAY_MS, found_ms)
    figures.append(f"owner {number.name}: last throttle after {told}; time to live {TTL_MS} ms")


def within(drive: Drive, bound_ms: float, measure: Callable[[], float]) -> str:
    """A figure within its bound; beyond it is measured once more, and both are told.

    One during which the gateway missed ticks, because the machine stalled, does not count.
    """
    found: list[float] = []
    left = 2
    while left and len(found) < 5:
        before = drive.skipped()
        found.append(measure())
        if found[-1] <= bound_ms:
            break
        left -= drive.skipped() == before
    told = ", then ".join(f"{ms:.1f} ms" for ms in found)
    assert found[-1] <= bound_ms, f"{told}; at most {bound_ms} ms"
    return told


def test_the_throttle_ends_when_the_owner_closes_its_sending_half(drive: Drive, figures: list[str]):
    def found_ms() -> float:
        with raw_owner(drive) as raw:
            raw.until_driving()
            raw.connection.shutdown(socket.SHUT_WR)
            return let_go_ms(drive, time.time_ns())

    # And not only after its time to live of 1000 ms.
    told = within(drive, 2 * PERIOD_MS + LEEWAY_MS, found_ms)
    figures.append(f"owner half closed: last throttle after {told}")


def test_old_sequence_numbers_do_not_keep_the_throttle(drive: Drive, figures: list[str]):
    def found_ms() -> float:
        with raw_owner(drive) as raw:
            raw.until_driving()
            last = raw.ask(20.0, TTL_MS)
            asked_ns = time.time_ns()
            for _ in range(20):
                answer = raw.demand(last, 20.0, TTL_MS)
                assert answer["error"]["data"]["refusal"] == "old_sequence"
                time.sleep(0.03)
            return let_go_ms(drive, asked_ns)

    told = within(drive, TTL_MS + PERIOD_MS + LEEWAY_MS, found_ms)
    figures.append(f"old sequence numbers: last throttle after {told}")


@dataclass
class Raw:
    """A connection whose requests a test writes itself."""

    drive: Drive
    connection: socket.socket
    reader: TextIO

    def say(self, method: str, **params: Any) -> dict[str, Any]:
        request = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}
        self.connection.sendall(json.dumps(request).encode() + b"\n")
        answer: dict[str, Any] = json.loads(self.reader.readline())
        return answer

    def demand(self, sequence: int, throttle_pct: float, ttl_ms: int) -> dict[str, Any]:
        values = {"throttle_pct": throttle_pct, "power_mode": "normal"}
        return self.say("demand.set", source="raw", sequence=sequence, ttl_ms=ttl_ms, values=values)

    def ask(self, throttle_pct: float, ttl_ms: int = 1000) -> int:
        """Ask with a new sequence number, which is granted; the number."""
        sequence = next(SEQUENCES)
        answer = self.demand(sequence, throttle_pct, ttl_ms)
        assert "result" in answer, answer
        return sequence

    def until_driving(self) -> None:
        """Arm, and ask for throttle until it is on the bus; again where a stall ended it."""
        wait_until(self._drives, "throttle on the bus")

    def _drives(self) -> bool:
        mode = self.say("why")["result"]["mode"]
        self.ask(20.0 if mode == "active" else 0.0)
        if mode == "fault":
            self.say("reset")
        if mode == "standby":
            self.say("arm")
        return mode == "active" and self.drive.last_throttle() >= THROTTLE_RAW


@contextlib.contextmanager
def raw_owner(drive: Drive) -> Iterator[Raw]:
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(PATIENCE_S)
        connection.connect(str(drive.stand.socket_path))
        yield Raw(drive, connection, connection.makefile("r"))


def test_a_second_client_never_gets_its_throttle_onto_the_bus(drive: Drive):
    drive.owner()
    drive.until_driving()
    begun_ns = drive.commands_since(time.time_ns(), count=2)[-1].stamp_ns  # of both controllers
    with drive.client as client:
        for _ in range(10):
            joystick = client.demand("joystick")
            with pytest.raises(RefusedError, match="driver owns the demand"), joystick:
                joystick.set(throttle_pct=90)
    drive.commands_since(time.time_ns(), count=4)
    commands = drive.commands_since(begun_ns, count=6)
    assert {frame.data[1] for frame in commands} == {THROTTLE_RAW}


def open_to_all(folder: Path) -> None:
    """Let every user come as far as this folder: what holds them up is the socket."""
    for one in (folder, *folder.parents[:2]):
        one.chmod(0o755)


def refusals(drive: Drive) -> list[dict[str, object]]:
    return [entry for entry in drive.gateway.log() if entry["event"] == "api_refused"]


def be_a_stranger(path: Path) -> None:
    os.setgroups([])
    os.setgid(NOBODY)
    os.setuid(NOBODY)
    with Client(path, timeout_s=PATIENCE_S) as client:
        wait_until(lambda: client.why()["mode"] == "standby", "standby")
        for refused in (client.arm, client.reset, client.reload, client.demand("me").__enter__):
            with pytest.raises(NoRightError):
                refused()
        client.disarm()


def test_the_socket_is_closed_to_users_outside_its_group(drive: Drive):
    open_to_all(drive.stand.folder)
    stranger = drive.stand.run(functools.partial(knock, drive.stand.socket_path))
    stranger.join(PATIENCE_S)
    assert stranger.exitcode == 0


def knock(path: Path) -> None:
    os.setgroups([])
    os.setgid(NOBODY)
    os.setuid(NOBODY)
    with socket.socket(socket.AF_UNIX) as connection, pytest.raises(PermissionError):
        connection.connect(str(path))


def test_a_reload_leaves_no_gap_in_the_commands(drive: Drive, figures: list[str]):
    """By signal and by request, taken and refused."""
    drive.owner()
    told, calm = [], 0
    for number, limits_w in enumerate(LIMITS_W):
        late_ticks = drive.stand.folder / f"late_ticks-{number}"
        begin = drive.stand.held(functools.partial(reference_ticks.run, late_ticks, 2.5, 0.0005))
        drive.until_driving()
        begin()
        gaps_ms = reloaded(drive, *limits_w)
        wait_until(late_ticks.exists, "the bystander")
        stalls = reference_ticks.skipped(late_ticks)
        told.append(f"{max(gaps_ms):.1f} ms ({stalls} ticks missed by a bystander)")
        calm += stalls == 0
        missed = sum(round(gap_ms / PERIOD_MS) - 1 for gap_ms in gaps_ms) / len(COMMANDS)
        # What the machine takes from every process is no fault of the reload.
        leaves_none = max(gaps_ms) < 1.5 * PERIOD_MS or missed <= 2 * stalls
        if leaves_none or calm == 2:
            break
    figures.append("reload: widest gap " + ", then ".join(told))
    assert leaves_none, told


LIMITS_W = ((40_000, 36_000), (32_000, 28_000), (24_000, 20_000), (16_000, 12_000))


def reloaded(drive: Drive, by_request_w: int, by_signal_w: int) -> list[float]:
    """Reload stricter limits twice, try two files that are refused; the gaps meanwhile, ms."""
    begun_ns = time.time_ns()
    with drive.client as client:
        drive.stand.configure(f"limits: {{power_limit_max_w: {by_request_w}}}\n")
        assert client.reload()["changed"] == ["limits.power_limit_max_w"]
        drive.stand.configure(f"limits: {{power_limit_max_w: {by_signal_w}}}\n")
        drive.gateway.popen.send_signal(signal.SIGHUP)
        drive.commands_when(begun_ns, "SIGHUP's limit", lambda found: are_at(found, by_signal_w))
        drive.stand.configure("limits: {power_limit_max_w: 60000}\n")
        with pytest.raises(ConfigRefusedError, match="may only become smaller"):
            client.reload()
        drive.stand.configure("limits: [")
        with pytest.raises(ConfigRefusedError):
            client.reload()
    drive.commands_since(time.time_ns(), count=10)
    commands = drive.commands_when(begun_ns, "no more", lambda found: are_at(found, by_signal_w))
    stamps_ns = [[f.stamp_ns for f in commands if f.can_id == can_id] for can_id in COMMANDS]
    return [(b - a) / MS for one in stamps_ns for a, b in itertools.pairwise(one)]


def are_at(commands: list[Recorded], limit_w: int) -> bool:
    """Whether the last ones tell both controllers of this limit."""
    limits_w = {int.from_bytes(frame.data[6:8], "little") for frame in commands[-2:]}
    return limits_w == {limit_w}
