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
from dataclasses import dataclass
from multiprocessing.context import ForkProcess
from pathlib import Path

import pytest

from tests.vcan.conftest import COMMANDS, Process, Recorded, Recording, Stand, wait_until
from vcu_gateway.client import Client, ConfigRefusedError, NoRightError, RefusedError

MS = 1_000_000
PERIOD_MS = 50
LEEWAY_MS = 5
TTL_MS = 200
NOBODY = 65534
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
        return Client(self.stand.socket_path)

    def until_ready(self) -> None:
        with self.client as client:
            wait_until(lambda: _ready(client), f"standby; the gateway: {self.gateway.err}")

    def owner(self, throttle_pct: float = 20.0, ttl_ms: int = TTL_MS) -> ForkProcess:
        """A process that arms and drives until it is stopped."""
        work = functools.partial(own, self.stand.socket_path, throttle_pct, ttl_ms)
        return self.stand.run(work)

    def until_driving(self) -> None:
        wait_until(lambda: self.last_throttle() >= THROTTLE_RAW, "throttle on the bus")

    def last_throttle(self) -> int:
        commands = self.recording.commands()
        return commands[-1].data[1] if commands else 0

    def commands_until_the_end(self) -> list[Recorded]:
        time.sleep(0.5)
        for child in self.stand.children:
            child.popen.kill()
        return self.recording.commands()


def _ready(client: Client) -> bool:
    try:
        why = client.why()
    except Exception:  # noqa: BLE001 - not there yet
        return False
    return why["mode"] == "standby" and not why["blocks"]


def own(path: Path, throttle_pct: float, ttl_ms: int) -> None:
    with Client(path) as client, client.demand("driver", ttl_ms=ttl_ms, hold_s=None) as owner:
        client.arm()
        owner.set(throttle_pct=throttle_pct, power_mode="normal")
        signal.pause()


@pytest.fixture
def drive(stand: Stand) -> Drive:
    return begin(stand)


def begin(stand: Stand, config: str = "") -> Drive:
    recording = stand.record()
    gateway = stand.gateway(config)
    wait_until(lambda: "link_open" in gateway.err.read_text(), "the gateway")
    stand.vehicle(QUIET)
    one = Drive(stand, recording, gateway)
    one.until_ready()
    return one


def let_go_ms(commands: list[Recorded], at_ns: int) -> float:
    """From `at_ns` to the last throttle of either controller; zero torque follows."""
    last_ns = max(frame.stamp_ns for frame in commands if frame.data[1] > 0)
    assert len([frame for frame in commands if frame.stamp_ns > last_ns]) >= 10
    return (last_ns - at_ns) / MS


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=lambda one: one.name)
def test_the_throttle_ends_within_the_time_to_live_when_its_owner_is_killed_or_stopped(
    drive: Drive, figures: list[str], number: signal.Signals
):
    owner = drive.owner()
    drive.until_driving()
    killed_ns = time.time_ns()
    os.kill(owner.pid or 0, number)
    found_ms = let_go_ms(drive.commands_until_the_end(), killed_ns)
    figures.append(
        f"owner {number.name}: last throttle after {found_ms:.1f} ms; time to live {TTL_MS} ms"
    )
    assert found_ms <= TTL_MS + PERIOD_MS + LEEWAY_MS


def test_the_throttle_ends_when_the_owner_closes_its_sending_half(drive: Drive, figures: list[str]):
    with raw_owner(drive) as (connection, say):
        say("demand.set", source="raw", sequence=2, ttl_ms=1000, values=THROTTLE)
        drive.until_driving()
        closed_ns = time.time_ns()
        connection.shutdown(socket.SHUT_WR)
        found_ms = let_go_ms(drive.commands_until_the_end(), closed_ns)
    figures.append(f"owner half closed: last throttle after {found_ms:.1f} ms")
    assert found_ms <= 2 * PERIOD_MS + LEEWAY_MS, "not only after its time to live of 1000 ms"


def test_old_sequence_numbers_do_not_keep_the_throttle(drive: Drive, figures: list[str]):
    with raw_owner(drive) as (_, say):
        for sequence in range(2, 30):
            say("demand.set", source="raw", sequence=sequence, ttl_ms=TTL_MS, values=THROTTLE)
            time.sleep(0.03)
        asked_ns = time.time_ns()
        for _ in range(20):
            answer = say("demand.set", source="raw", sequence=29, ttl_ms=TTL_MS, values=THROTTLE)
            assert answer["error"]["data"]["refusal"] == "old_sequence"
            time.sleep(0.03)
        found_ms = let_go_ms(drive.commands_until_the_end(), asked_ns)
    figures.append(f"old sequence numbers: last throttle after {found_ms:.1f} ms")
    assert found_ms <= TTL_MS + PERIOD_MS + LEEWAY_MS


THROTTLE = {"throttle_pct": 20.0, "power_mode": "normal"}


def raw_owner(drive: Drive):
    """A connection whose requests a test writes itself, armed."""

    @contextlib.contextmanager
    def opened():
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(5)
            connection.connect(str(drive.stand.socket_path))
            reader = connection.makefile("r")

            def say(method: str, **params: object) -> dict:
                request = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}
                connection.sendall(json.dumps(request).encode() + b"\n")
                return json.loads(reader.readline())

            still = {"throttle_pct": 0.0, "power_mode": "normal"}
            say("demand.set", source="raw", sequence=1, ttl_ms=1000, values=still)
            assert say("arm")["result"]["mode"] == "active"
            yield connection, say

    return opened()


def test_a_second_client_never_gets_its_throttle_onto_the_bus(drive: Drive):
    drive.owner()
    drive.until_driving()
    time.sleep(2 * PERIOD_MS / 1000)  # both controllers
    begun_ns = time.time_ns()
    with drive.client as client:
        for _ in range(10):
            joystick = client.demand("joystick")
            with pytest.raises(RefusedError, match="driver owns the demand"), joystick:
                joystick.set(throttle_pct=90)
    commands = [frame for frame in drive.recording.commands() if frame.stamp_ns > begun_ns]
    assert {frame.data[1] for frame in commands} == {THROTTLE_RAW}


def test_another_user_may_read_and_stop_and_nothing_else(stand: Stand):
    stand.api = ", socket_mode: '0666'"
    stand.folder.chmod(0o755)
    for parent in stand.folder.parents[:2]:
        parent.chmod(0o755)
    drive = begin(stand)
    stranger = stand.run(functools.partial(be_a_stranger, stand.socket_path))
    stranger.join(20)
    assert stranger.exitcode == 0
    refused = [entry for entry in drive.gateway.log() if entry["event"] == "api_refused"]
    assert {entry["method"] for entry in refused} >= {"arm", "reset", "config.reload", "demand.set"}
    assert {(entry["uid"], entry["pid"]) for entry in refused} == {(NOBODY, stranger.pid)}


def be_a_stranger(path: Path) -> None:
    os.setgroups([])
    os.setgid(NOBODY)
    os.setuid(NOBODY)
    with Client(path) as client:
        assert client.why()["mode"] == "standby"
        for refused in (client.arm, client.reset, client.reload, client.demand("me").__enter__):
            with pytest.raises(NoRightError):
                refused()
        client.disarm()


def test_the_socket_is_closed_to_users_outside_its_group(drive: Drive):
    stranger = drive.stand.run(functools.partial(knock, drive.stand.socket_path))
    stranger.join(20)
    assert stranger.exitcode == 0


def knock(path: Path) -> None:
    path.parent.chmod(0o755)
    os.setgroups([])
    os.setgid(NOBODY)
    os.setuid(NOBODY)
    with socket.socket(socket.AF_UNIX) as connection, pytest.raises(PermissionError):
        connection.connect(str(path))


def test_a_reload_leaves_no_gap_in_the_commands(drive: Drive, figures: list[str]):
    """By signal and by request, taken and refused."""
    drive.owner()
    drive.until_driving()
    begun_ns = time.time_ns()
    with drive.client as client:
        drive.stand.configure("limits: {power_limit_max_w: 40000}\n")
        assert client.reload()["changed"] == ["limits.power_limit_max_w"]
        drive.stand.configure("limits: {power_limit_max_w: 30000}\n")
        drive.gateway.popen.send_signal(signal.SIGHUP)
        wait_until(lambda: drive.gateway.err.read_text().count("config_reloaded") == 2, "SIGHUP")
        drive.stand.configure("limits: {power_limit_max_w: 60000}\n")
        with pytest.raises(ConfigRefusedError, match="may only become stricter"):
            client.reload()
        drive.stand.configure("limits: [")
        with pytest.raises(ConfigRefusedError):
            client.reload()
    commands = [f for f in drive.commands_until_the_end() if f.stamp_ns > begun_ns]
    for can_id in COMMANDS:
        stamps_ns = [frame.stamp_ns for frame in commands if frame.can_id == can_id]
        widest_ms = max(b - a for a, b in itertools.pairwise(stamps_ns)) / MS
        figures.append(f"reload: widest gap of {can_id:08X} {widest_ms:.1f} ms")
        assert widest_ms < 1.5 * PERIOD_MS
    limits_w = [int.from_bytes(frame.data[6:8], "little") for frame in commands]
    assert limits_w[-1] == 30000
