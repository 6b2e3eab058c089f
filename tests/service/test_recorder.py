"""The installed recorder under a real systemd: started by its socket, in a sandbox of its own."""

import json
import os
import pwd
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.recorder.gateway import Gateway
from tests.service.conftest import STRANGER, Booted
from tests.service.driver import Driver
from tests.service.test_running import as_user
from tests.service.unit import PATIENCE_S, Unit, systemctl
from tests.vcan.conftest import wait_until
from vcu_gateway.recording import layout
from vcu_gateway.recording.check import RecordingState, check_recording
from vcu_gateway.recording.folder import RecordingFolder, RecordingPath

SOCKET, SERVICE = "vcu-gateway-recorder.socket", "vcu-gateway-recorder.service"
RUNTIME = Path("/run/vcu-gateway-recorder")
TAP = RUNTIME / "tap.sock"
RECORDINGS = Path("/var/lib/vcu-gateway-recorder")
READER = "reader"
EXPOSURE = 0.3


def show(unit: str, name: str) -> str:
    return systemctl("show", "--value", f"--property={name}", unit).stdout.strip()


def pid() -> int:
    return int(show(SERVICE, "MainPID"))


def journal() -> str:
    """What it said, for a test that fails."""
    return subprocess.run(
        ["journalctl", "--unit", SERVICE, "--no-pager", "--output", "cat", "--lines=20"],
        capture_output=True,
        text=True,
    ).stdout


@pytest.fixture
def gateway(booted: Booted) -> Iterator[Gateway]:
    """A gateway's end of the tap, connected."""
    one = Gateway(TAP)
    one.connect()
    yield one
    one.close()


@pytest.fixture
def recording(gateway: Gateway) -> RecordingPath:
    return recording_of(gateway)


@pytest.fixture(scope="module")
def steady_gateway(booted: Booted) -> Iterator[Gateway]:
    """The same for all tests that leave its drive as it is."""
    one = Gateway(TAP, channel="vcan1")  # apart from the service's
    one.connect()
    yield one
    one.close()


@pytest.fixture(scope="module")
def steady(steady_gateway: Gateway) -> RecordingPath:
    """Of that gateway, still being written."""
    return recording_of(steady_gateway)


def recording_of(gateway: Gateway) -> RecordingPath:
    """The gateway's drive, some seconds of it on the disk."""
    gateway.drive(2.5)
    name = layout.drive_name(gateway.clock["wall_ns"], gateway.run)
    path = RECORDINGS / layout.DRIVES / name
    wait_until(lambda: path.exists() and bool(layout.segments(path)), journal(), PATIENCE_S)
    return RecordingPath("drive", path)


@pytest.fixture(scope="module")
def reader(people: None) -> None:
    """A user who may read recordings."""
    subprocess.run(["useradd", "-G", "vcu-gateway-recorder", READER], check=True)


def test_the_boot_listens_and_the_first_gateway_starts_it(booted: Booted):
    assert show(SOCKET, "UnitFileState") == "enabled"
    assert show(SOCKET, "ActiveState") == "active"
    one = Gateway(TAP)
    one.connect()
    wait_until(lambda: show(SERVICE, "ActiveState") == "active", "started", PATIENCE_S)
    one.close()


def test_it_writes_as_its_own_user_what_its_group_may_read(steady: RecordingPath):
    user = pwd.getpwnam("vcu-gateway-recorder")
    assert os.stat(f"/proc/{pid()}").st_uid == user.pw_uid
    assert RECORDINGS.stat().st_mode & 0o7777 == 0o750
    for path in [steady.path, *steady.path.iterdir()]:
        found = path.stat()
        assert (found.st_uid, found.st_gid) == (user.pw_uid, user.pw_gid)
        assert found.st_mode & (0o027 if path.is_dir() else 0o037) == 0, path


def test_whoever_is_in_its_group_lists_and_checks_and_nobody_else_does(
    steady: RecordingPath, reader: None
):
    listed = as_user(READER, "vcu-gateway", "recordings", "list")
    assert listed.returncode == 0, listed.stderr
    assert steady.name in listed.stdout
    assert "being written" in listed.stdout
    refused = as_user(STRANGER, "vcu-gateway", "recordings", "list")
    assert refused.returncode == 77
    assert "usermod -aG vcu-gateway-recorder" in refused.stderr
    kept = as_user(READER, "vcu-gateway", "recordings", "keep", steady.name)
    assert kept.returncode == 77
    assert "use sudo" in kept.stderr


def test_what_root_keeps_the_recorder_owns(steady: RecordingPath):
    done = subprocess.run(["vcu-gateway", "recordings", "keep", steady.name])
    assert done.returncode == 0
    assert (steady.path / layout.KEEP_FILE).owner() == "vcu-gateway-recorder"
    subprocess.run(["vcu-gateway", "recordings", "remove", "--yes", steady.name])
    assert steady.path.exists(), "it is being written"


def test_keep_now_makes_an_incident(steady_gateway: Gateway, steady: RecordingPath):
    command = ["vcu-gateway", "recordings", "keep", "now"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as keeping:
        while keeping.poll() is None:
            steady_gateway.drive(0.1)
        assert keeping.stdout is not None
        name = keeping.stdout.read().strip()
    assert (RECORDINGS / layout.INCIDENTS / name / layout.INCIDENT_FILE).exists()


def test_the_exporters_user_reads_its_state_and_a_stranger_does_not(
    steady: RecordingPath, people: None
):
    status = RUNTIME / "status.json"
    wait_until(lambda: json.loads(status.read_text())["totals"]["frames"] > 0, "told", PATIENCE_S)
    exporter = [
        "runuser",
        "-u",
        "vcu-gateway-exporter",
        "-G",
        "vcu-gateway",
        "--",
        "cat",
        str(status),
    ]
    assert subprocess.run(exporter, stdout=subprocess.DEVNULL).returncode == 0
    assert as_user(STRANGER, "cat", str(status)).returncode != 0


def connected_drives() -> dict[str, str]:
    """Drive by channel, of the gateways that are connected."""
    connections = json.loads((RUNTIME / "status.json").read_text())["connections"]
    return {one["channel"]: one["drive"] for one in connections if one["drive"]}


def test_the_service_is_recorded_out_of_its_root_folder_from_start_to_end(
    service: Unit, driver: Driver
):
    driver.drive()
    wait_until(lambda: "vcan0" in connected_drives(), "a drive of vcan0", PATIENCE_S)
    drive = RecordingPath("drive", RECORDINGS / layout.DRIVES / connected_drives()["vcan0"])
    counts = driver.client.health()["recorder"]
    assert counts is not None
    assert counts["connected"]
    assert counts["lost_datagrams"] == 0
    service.stop()
    wait_until(lambda: not layout.is_held(drive.path), "the end of the drive", PATIENCE_S)
    found = check_recording(drive, lambda size: None)
    assert found.is_whole, found
    assert not found.is_cut_off
    assert found.frames > 0


def test_it_has_no_network_no_rights_and_no_priority(steady: RecordingPath):
    process = Path(f"/proc/{pid()}")
    assert os.readlink(process / "ns/net") != os.readlink("/proc/self/ns/net")
    status = dict(
        line.split(":\t", 1)
        for line in (process / "status").read_text().splitlines()
        if ":\t" in line
    )
    assert int(status["CapEff"], 16) == int(status["CapBnd"], 16) == 0
    assert (status["NoNewPrivs"], status["Seccomp"]) == ("1", "2")
    assert os.sched_getscheduler(pid()) == os.SCHED_OTHER
    assert os.getpriority(os.PRIO_PROCESS, pid()) == 10
    assert show(SERVICE, "MemoryMax") == str(128 << 20)
    seen = set(os.listdir(process / "root"))
    assert "srv" not in seen
    assert os.listdir(process / "root/home") == []


def test_it_is_exposed_as_little_as_the_unit_says():
    done = subprocess.run(
        ["systemd-analyze", "security", "--no-pager", f"--threshold={EXPOSURE * 10:.0f}", SERVICE],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout


def gone_on(gateway: Gateway, recording: RecordingPath) -> bool:
    """After another half second: whether a second segment has lines."""
    gateway.drive(0.5)
    found = layout.segments(recording.path)[1:]
    return any(path.stat().st_size for segment in found for path in segment.paths)


@pytest.mark.ci
def test_killed_it_comes_back_and_goes_on_with_the_drive(
    gateway: Gateway, recording: RecordingPath
):
    before = pid()
    os.kill(before, signal.SIGKILL)
    wait_until(lambda: pid() not in (0, before), "restarted", PATIENCE_S)
    wait_until(lambda: gone_on(gateway, recording), "the next segment", PATIENCE_S)
    found = check_recording(recording, lambda size: None)
    assert found.is_whole, found
    assert found.gaps.frames > 0


@pytest.mark.ci
def test_stopping_the_socket_stops_it_for_good_and_the_drive_says_so(
    gateway: Gateway, recording: RecordingPath
):
    assert systemctl("stop", SOCKET).returncode == 0
    assert show(SERVICE, "ActiveState") == "inactive"
    assert show(SERVICE, "Result") == "success"
    assert not TAP.exists()
    found = check_recording(recording, lambda size: None)
    (fault,) = found.faults  # the gateway drove on
    assert "the recorder ended the connection" in fault.what
    assert found.state is RecordingState.INCOMPLETE
    assert systemctl("start", SOCKET).returncode == 0


@pytest.mark.ci
def test_the_gateway_runs_on_without_it(service: Unit):
    systemctl("stop", SOCKET)
    assert service.show("ActiveState") == "active"
    service.restart()
    assert service.show("ActiveState") == "active"
    assert RecordingFolder(RECORDINGS).recordings()
    wait_until(lambda: show(SOCKET, "ActiveState") == "active", "wanted by it", PATIENCE_S)
