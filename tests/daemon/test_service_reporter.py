"""A run as a service: ready, alive, its status, and what it leaves for the next one."""

import contextlib
import os
import socket
import subprocess
import sys
import time
from types import SimpleNamespace
from typing import cast

import pytest

from tests.core.simulated_drive import CODEC, Drive, active, standby
from vcu_gateway.bus.connection import BusConnection, BusSettings
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.daemon import systemd
from vcu_gateway.daemon.loop import LastTick, TickLoop
from vcu_gateway.daemon.restart_state import CountedStart
from vcu_gateway.daemon.systemd import ReceiverWatchdog, ServiceReporter, SystemdNotifier

S = 1_000_000_000
ZERO_TORQUE = "0008A7D0#0C000000E02E0000\n0008A8D0#0C000000E02E0000\n"


class ServiceRig:
    """A driving vehicle and a service manager that listens; time is the test's."""

    def __init__(self, folder, manager_socket, drive: Drive, monkeypatch) -> None:
        self.drive, self.folder, self.manager_socket = drive, folder, manager_socket
        connection = BusConnection(
            BusSettings("socketcan", "can0"), CODEC.identifiers(), lambda frame: None
        )
        connection.lost = None
        self.loop = TickLoop(drive.gateway, connection, 50)
        manager = SystemdNotifier(
            {"NOTIFY_SOCKET": manager_socket.getsockname(), "WATCHDOG_USEC": "2000000"}, 100
        )
        self.service = ServiceReporter(manager, folder, self.loop)
        self._told: list[str] = []
        monkeypatch.setattr(
            "vcu_gateway.daemon.systemd.time.monotonic_ns", lambda: self.drive.now_ns
        )

    def tick(self, times: int = 1) -> None:
        for _ in range(times):
            result = self.drive.tick()
            self.loop.latest = LastTick.explained(self.drive.gateway, result, self.drive.now_ns)
            self.service.observe(result)
            self._listen()

    def _listen(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                self._told.append(self.manager_socket.recv(2000).decode())

    def told(self) -> list[str]:
        """What the service manager was told since the last call."""
        self._listen()
        told, self._told = self._told, []
        return told

    @property
    def safe_frames(self) -> str:
        path = self.folder / "safe-frames"
        return path.read_text() if path.exists() else ""


@pytest.fixture
def rig(tmp_path, monkeypatch):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager_socket:
        manager_socket.bind(str(tmp_path / "notify"))
        manager_socket.setblocking(False)

        def make(drive: Drive) -> ServiceRig:
            return ServiceRig(tmp_path, manager_socket, drive, monkeypatch)

        yield make


def test_ready_is_reported_once_after_the_first_tick(rig):
    one = rig(standby())
    assert one.told() == []
    one.tick(10)
    assert one.told().count("READY=1") == 1


def test_a_living_gateway_pings_four_times_in_the_watchdogs_time(rig):
    one = rig(standby())
    one.tick(200)  # 10 s
    assert one.told().count("WATCHDOG=1") == 20


def test_the_status_is_the_headline_and_is_reported_when_it_changes(rig):
    one = rig(standby())
    one.tick(100)
    assert [line for line in one.told() if line.startswith("STATUS")] == ["STATUS=standby; arm"]
    assert one.drive.arm().granted
    one.tick(1)
    assert [line for line in one.told() if line.startswith("STATUS")] == [
        "STATUS=active; drive; disarm to end"
    ]


def test_the_status_of_a_missing_interface_says_so(rig):
    one = rig(standby())
    one.loop.connection.lost = "can0: no such interface"
    one.tick()
    assert "STATUS=standby; can0: no such interface" in one.told()


def test_a_status_that_flickers_is_reported_once_a_second(rig):
    one = rig(standby())
    for number in range(100):  # 5 s
        one.loop.connection.lost = f"reason {number}"
        one.tick()
    assert len([line for line in one.told() if line.startswith("STATUS")]) == 5


def test_the_end_is_reported_when_it_begins(rig):
    one = rig(standby())
    one.tick()
    assert "STOPPING=1" not in one.told()
    one.drive.gateway.requests.terminate()
    one.tick(3)
    assert one.told().count("STOPPING=1") == 1


# Receiving.


class FakeConnection(SimpleNamespace):
    drains: int | None = 0


def test_a_bus_that_is_read_at_every_third_tick_is_received():
    connection = FakeConnection()
    watch = ReceiverWatchdog(cast(BusConnection, connection))
    for tick in range(100):
        connection.drains = tick // 3
        watch.observe()
        assert watch.alive


def test_a_bus_that_is_not_read_for_ten_ticks_is_in_doubt_and_for_twenty_lost():
    connection = FakeConnection()
    watch = ReceiverWatchdog(cast(BusConnection, connection))
    alive = []
    for _ in range(20):
        watch.observe()
        alive.append(watch.alive)
    assert alive == [True] * 10 + [False] * 10
    with pytest.raises(RuntimeError, match="not read any more"):
        watch.observe()


def test_without_an_open_bus_nothing_is_expected_to_be_read():
    connection = FakeConnection(drains=None)
    watch = ReceiverWatchdog(cast(BusConnection, connection))
    for _ in range(100):
        watch.observe()
    assert watch.alive


def test_a_bus_that_is_read_again_is_received_again():
    connection = FakeConnection()
    watch = ReceiverWatchdog(cast(BusConnection, connection))
    for _ in range(15):
        watch.observe()
    connection.drains = 1
    watch.observe()
    assert watch.alive


def test_a_bus_that_is_not_read_ends_the_pings_and_then_the_process(rig, monkeypatch):
    one = rig(standby())
    monkeypatch.setattr(BusConnection, "drains", 7)
    one.tick(20)
    before = one.told().count("WATCHDOG=1")
    assert 0 < before < 3
    with pytest.raises(RuntimeError, match="not read any more"):
        one.tick()


# What is left for safe_stop and for the next start.


def test_nothing_is_left_before_anything_was_sent(rig):
    one = rig(Drive())
    one.tick(10)
    assert one.safe_frames == ""


def test_the_safe_frames_of_a_drive_are_zero_torque(rig):
    one = rig(active())
    one.drive.demanded = ControllerDemand(throttle_pct=40)
    one.tick(40)
    assert one.safe_frames == f"can0\n{ZERO_TORQUE}"


def test_a_power_cut_is_kept_for_whoever_sends_next(rig):
    one = rig(active())
    one.tick()
    one.drive.gateway.requests.emergency_stop()
    one.tick()
    assert one.safe_frames == f"can0\n{ZERO_TORQUE.replace('#0C', '#8C')}"


def test_they_are_written_only_when_they_change(rig):
    one = rig(active())
    one.tick(2)
    (one.folder / "safe-frames").unlink()
    one.tick(100)
    assert one.safe_frames == ""


def test_what_a_process_before_left_is_forgotten_before_anything_is_sent(tmp_path):
    left = tmp_path / "safe-frames"
    left.write_text(f"can0\n{ZERO_TORQUE}")
    for _ in range(2):
        systemd.forget(tmp_path)
        assert not left.exists()


def test_a_run_forgets_them_before_it_has_sent_anything(tmp_path):
    config, left = tmp_path / "gateway.yaml", tmp_path / "safe-frames"
    config.write_text(
        f"bus: {{interface: virtual, channel: {tmp_path.name}}}\napi: {{enabled: false}}\n"
    )
    left.write_text(f"can0\n{ZERO_TORQUE}")
    command = [sys.executable, "-m", "vcu_gateway", "run", "-c", str(config)]
    environment = {**os.environ, "RUNTIME_DIRECTORY": str(tmp_path)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL) as process:
        deadline_s = time.monotonic() + 60
        while not (tmp_path / "starts").exists():
            assert time.monotonic() < deadline_s
            time.sleep(0.005)
        found = left.read_text() if left.exists() else ""
        process.kill()
    assert "can0" not in found


def test_a_folder_that_cannot_be_written_is_reported_and_stops_nobody(rig):
    one = rig(active())
    (one.folder / "safe-frames.new").mkdir()
    one.tick(3)
    names = [entry.event.name for entry in one.loop.event_log.latest(10)]
    assert names.count("safe_frames_unwritten") == 1


def test_an_orderly_end_leaves_no_safe_frames_and_begins_a_new_drive(rig):
    one = rig(active())
    one.service.begin()
    one.tick(2)
    one.service.end()
    assert one.safe_frames == ""
    one.service.begin()
    assert one.service.start == CountedStart(2, 0)


def test_safe_frames_that_did_not_leave_are_left_to_the_next_process(rig):
    one = rig(active())
    one.service.begin()
    one.tick(2)
    one.drive.gateway.requests.terminate()
    one.drive.accepted = False
    one.tick(10)
    one.service.end()
    assert one.safe_frames == f"can0\n{ZERO_TORQUE}"
    one.service.begin()
    assert one.service.start == CountedStart(2, 0), "an end that was asked for"


def test_a_third_unexpected_restart_ends_arming_and_is_reported(rig):
    for times in range(4):
        one = rig(standby())
        one.service.begin()
        assert one.service.start == CountedStart(times + 1, times)
        assert one.drive.arm().granted is (times < 3)
    assert [entry.event.fields for entry in one.loop.event_log.latest(1)] == [{"in_this_drive": 3}]


def test_without_a_folder_nothing_is_counted_and_nothing_left(rig):
    one = rig(standby())
    one.service = ServiceReporter(SystemdNotifier({}, 100), None, one.loop)
    one.service.begin()
    one.tick(3)
    one.service.end()
    assert one.service.start is None
    assert one.safe_frames == ""


def test_a_failure_to_write_is_made_good_when_it_can_be(rig):
    one = rig(active())
    blocked = one.folder / "safe-frames.new"
    blocked.mkdir()
    one.tick(3)
    assert one.safe_frames == ""
    blocked.rmdir()
    one.tick()
    assert one.safe_frames == f"can0\n{ZERO_TORQUE}"
