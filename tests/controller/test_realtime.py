"""The gateway on a PREEMPT_RT kernel: real-time policy, locked memory, beside busy programs."""

import contextlib
import itertools
import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.controller.conftest import GATEWAY, VEHICLE
from tests.faults.driving import MS, PERIOD_MS, QUIET, BusStand, Driving, record
from tests.service.driver import Driver
from tests.service.unit import NAME, Unit, systemctl
from tests.vcan.conftest import COMMANDS, Process, Recorded, Stand, ended_after, wait_until

pytestmark = pytest.mark.slow

REALTIME = Path("/sys/kernel/realtime")
SERVICE = Path("/lib/systemd/system", NAME)
LEEWAY_MS = 5
PRIORITY = 40
VEHICLE_PRIORITY = 30  # a vehicle is no program that waits for a processor
HOGS = 3
WATCHED_S = 5.0


@pytest.fixture(autouse=True)
def a_realtime_kernel(two_controllers: None) -> None:
    if REALTIME.exists() and REALTIME.read_text() == "1\n":
        systemctl("stop", NAME)  # a package that was installed: the boot has started it
        return
    why = "no PREEMPT_RT kernel: `lab run --qemu --kernel rt`"
    if os.environ.get("VCU_REQUIRE_REALTIME"):
        pytest.fail(why)
    pytest.skip(why)


class Locked(BusStand):
    """Its gateways lock their memory, as the service does."""

    def gateway(self, config: str = "", *options: str) -> Process:
        return super().gateway(config, "--lock-memory", *options)


def compute() -> None:
    while True:
        pass


@contextlib.contextmanager
def busy(stand: Stand) -> Iterator[None]:
    """Programs of the ordinary policy that would have the processor to themselves."""
    hogs = [stand.run(compute) for _ in range(HOGS)]
    try:
        yield
    finally:
        for hog in hogs:
            hog.kill()


def tasks(pid: int) -> list[int]:
    return [int(path.name) for path in Path(f"/proc/{pid}/task").iterdir()]


def make_realtime(pid: int, priority: int) -> None:
    for task in tasks(pid):
        os.sched_setscheduler(task, os.SCHED_FIFO, os.sched_param(priority))


def assert_realtime(pid: int) -> None:
    """Every thread of it has the policy, and its memory stays."""
    for task in tasks(pid):
        assert os.sched_getscheduler(task) == os.SCHED_FIFO
        assert os.sched_getparam(task).sched_priority == PRIORITY
    status = dict(
        line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines()
    )
    locked_kb, resident_kb = (int(status[name].split()[0]) for name in ("VmLck", "VmRSS"))
    assert locked_kb >= resident_kb / 2


def gaps_ms(frames: list[Recorded]) -> list[float]:
    """Between the commands of one controller."""
    one = [frame.stamp_ns for frame in frames if frame.can_id == COMMANDS[0]]
    return [(after - before) / MS for before, after in itertools.pairwise(one)]


def pid_of(process: Process) -> int:
    pid = process.popen.pid
    assert pid is not None
    return pid


def test_a_gateway_with_a_real_time_policy_is_punctual_beside_busy_programs(
    bus: None, tmp_path: Path, figures: list[str]
):
    with ended_after(Locked(tmp_path, channel=GATEWAY, forking=True)) as stand:
        driving = Driving(stand, wire=VEHICLE)
        driving.start_vehicle()
        driving.until_driving()
        assert driving.vehicle is not None
        make_realtime(pid_of(driving.vehicle), VEHICLE_PRIORITY)
        make_realtime(pid_of(driving.gateway), PRIORITY)
        assert_realtime(pid_of(driving.gateway))
        with busy(stand):
            begun_ns = time.time_ns()
            time.sleep(WATCHED_S)
            ended_ns = time.time_ns()
        found = gaps_ms(driving.commands(begun_ns, ended_ns))
        figures.append(
            f"SCHED_FIFO beside {HOGS} busy programs: {len(found)} gaps between commands, "
            f"{min(found):.1f} to {max(found):.1f} ms"
        )
        assert max(found) <= PERIOD_MS + LEEWAY_MS
        assert min(found) >= PERIOD_MS - LEEWAY_MS
        driving.check()
        driving.let_go()


def test_the_packaged_service_drives_can0_in_real_time_beside_busy_programs(
    bus: None, tmp_path: Path, figures: list[str]
):
    """As the package brings it: unit and configuration are not touched."""
    if not SERVICE.exists():
        pytest.skip("the package is not installed: `lab run --install build/deb/*.deb`")
    with ended_after(Stand(tmp_path, channel=GATEWAY, wire=VEHICLE, forking=True)) as stand:
        recording = record(stand, VEHICLE, COMMANDS)
        make_realtime(pid_of(stand.vehicle(QUIET)), VEHICLE_PRIORITY)
        unit, driver = Unit(), Driver(recording)
        unit.start()
        try:
            driver.drive()
            assert_realtime(unit.pid)
            restarts = unit.number("NRestarts")
            with busy(stand):
                begun_ns = time.time_ns()
                time.sleep(WATCHED_S)
                ended_ns = time.time_ns()
            frames = [f for f in recording.commands() if begun_ns < f.stamp_ns < ended_ns]
            found = gaps_ms(frames)
            figures.append(
                f"the service beside {HOGS} busy programs: {len(found)} gaps between commands, "
                f"{min(found):.1f} to {max(found):.1f} ms"
            )
            assert max(found) <= PERIOD_MS + LEEWAY_MS
            assert unit.number("NRestarts") == restarts
        finally:
            driver.let_go()
            unit.stop()
    wait_until(lambda: unit.show("ActiveState") == "inactive", "the service to end")
