"""The Debian package in a clean Debian with a systemd of its own and no network.

Run as root inside the lab, after all other tests of the guest, for it installs and removes the
package: VCU_DEB is the package, VCU_DEB_NEXT the same with a higher revision.
"""

import contextlib
import grp
import json
import os
import pwd
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

PACKAGE = "vcu-gateway"
SERVICE = "vcu-gateway.service"
INSTANCE = "vcu-gateway@second.service"
RECORDER, RECORDER_SOCKET = "vcu-gateway-recorder.service", "vcu-gateway-recorder.socket"
RECORDINGS = Path("/var/lib/vcu-gateway-recorder")
CONFIG = Path("/etc/vcu-gateway/gateway.yaml")
SECOND = CONFIG.with_name("second.yaml")
HOME = Path("/usr/lib/vcu-gateway")
PYTHON = os.path.realpath("/usr/bin/python3")
PACKAGED = HOME / f"lib/{Path(PYTHON).name}/site-packages/vcu_gateway/data/gateway.yaml"
PATIENCE_S = 120.0

pytestmark = [pytest.mark.timeout(1200), pytest.mark.ci]


@pytest.fixture(scope="session", autouse=True)
def a_real_systemd() -> None:
    """In place of the fixture of conftest.py: here the package is not there yet."""
    if os.environ.get("VCU_LAB") != "systemd" or "VCU_DEB" not in os.environ:
        pytest.skip("installs packages: needs the lab with a systemd of its own, and VCU_DEB")


@pytest.fixture(scope="session", autouse=True)
def booted(a_real_systemd: None) -> None:
    """In place of the fixture of conftest.py, which looks at the service that the boot started."""


def output(*words: str) -> str:
    """What the command printed, whatever its exit code."""
    done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    return done.stdout.strip()


def apt(*words: str) -> subprocess.CompletedProcess[str]:
    """apt-get, asked nothing: a question about a configuration file would be an error."""
    return subprocess.run(
        ["apt-get", "-y", "--no-install-recommends", "--allow-downgrades", *words],
        env={**os.environ, "DEBIAN_FRONTEND": "noninteractive", "LC_ALL": "C.UTF-8"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def install(package: str) -> str:
    done = apt("install", os.environ[package])
    assert done.returncode == 0, done.stdout
    return done.stdout


def remove(how: str = "remove") -> None:
    done = apt(how, PACKAGE)
    assert done.returncode == 0, done.stdout


def installed() -> tuple[str, str]:
    """State and revision, that without the release which it is built for."""
    state = output("dpkg-query", "-W", "-f", "${Status} ${Version}", PACKAGE)
    status, _, version = state.rpartition(" ")
    return status, version.rpartition("-")[2].partition("~")[0]


def show(unit: str, what: str) -> str:
    return output("systemctl", "show", "--value", "--property", what, unit)


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline, f"{what}; {why()}\n{journal()}"
        time.sleep(0.2)


def journal(*which: str) -> str:
    """What the service said, last unless told otherwise."""
    which = which or ("--lines=30",)
    return output("journalctl", "--unit", SERVICE, "--no-pager", "--output", "cat", *which)


def ended_by_itself(since_s: float) -> bool:
    """Whether a drive ended since then, but for an orderly end of the program."""
    since = journal(f"--since=@{since_s:.3f}").splitlines()
    told = [json.loads(line) for line in since if line.startswith("{")]
    changes = [(one["before"], one["after"]) for one in told if one["event"] == "mode_changed"]
    return not {("active", "fault"), ("active", "standby")}.isdisjoint(changes)


def why() -> dict[str, object]:
    """What the gateway answers; {} where it does not."""
    done = subprocess.run(["vcu-gateway", "why", "--json"], capture_output=True, text=True)
    return json.loads(done.stdout) if done.returncode == 0 else {}


def named_after_it() -> set[str]:
    """Every path with its name, without dpkg's own notes, logs and the tests."""
    found = output("find", "/", "-xdev", "-name", "*vcu-gateway*", "-not", "-path", "/var/log/*")
    runtime = output("find", "/run", "-maxdepth", "1", "-name", "vcu-gateway*")
    notes = ("/var/lib/dpkg/", "/var/cache/", "/tmp/", os.getcwd())
    return {path for path in f"{found}\n{runtime}".split() if not path.startswith(notes)}


@pytest.fixture
def first() -> str:
    """Installed for the first time; what was said."""
    output("systemctl", "stop", SERVICE, INSTANCE)
    output("dpkg", "--purge", PACKAGE)
    assert named_after_it() == set()
    return install("VCU_DEB")


@pytest.fixture
def revision_1() -> None:
    """Where another one may be installed by now."""
    if installed() != ("install ok installed", "1"):
        output("systemctl", "stop", SERVICE, INSTANCE)
        install("VCU_DEB")


@pytest.fixture
def ready() -> None:
    """Installed, enabled and not started, whatever an earlier test left behind."""
    output("systemctl", "stop", SERVICE, INSTANCE)
    if installed()[0] != "install ok installed":
        install("VCU_DEB")
    CONFIG.write_text(PACKAGED.read_text())
    SECOND.unlink(missing_ok=True)
    output("systemctl", "reset-failed")
    output("systemctl", "enable", SERVICE)
    found = show(SERVICE, "UnitFileState"), show(SERVICE, "ActiveState")
    assert found == ("enabled", "inactive")


@pytest.fixture
def running(ready: None) -> int:
    """On vcan0, started; its process."""
    CONFIG.write_text(CONFIG.read_text().replace("channel: can0\n", "channel: vcan0\n"))
    assert output("systemctl", "start", SERVICE) == ""
    return int(show(SERVICE, "MainPID"))


@pytest.fixture
def healthy(revision_1: None, running: int, vehicle: None) -> None:
    """Beside a healthy vehicle, ready to be armed."""
    until(lambda: why().get("mode") == "standby" and not why()["blocks"], "nothing blocks")


@contextlib.contextmanager
def demanding() -> Iterator[None]:
    """Somebody has the pedals, with a priority as the vehicle's."""
    demand = ["demand", "--throttle", "0", "--ttl-ms", "1000"]
    command = ["chrt", "--fifo", "30", "vcu-gateway", *demand]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            process.terminate()


def test_it_installs_without_a_network_enabled_and_not_started(first):
    assert installed() == ("install ok installed", "1")
    assert apt("check").returncode == 0
    assert (show(SERVICE, "UnitFileState"), show(SERVICE, "ActiveState")) == ("enabled", "inactive")
    assert output("systemctl", "is-enabled", INSTANCE) == "disabled"
    assert output("systemctl", "is-enabled", RECORDER_SOCKET) == "enabled"
    assert show(RECORDER_SOCKET, "ActiveState") == "inactive"
    said = [line for line in first.splitlines() if line.startswith("vcu-gateway: ")]
    assert len(said) == 2
    assert "vcu-gateway doctor" in said[0]
    assert "/usr/share/doc/vcu-gateway/docs/install.md" in said[1]


def test_its_user_is_one_of_the_system_that_nobody_logs_in_as(ready):
    user, group = pwd.getpwnam("vcu-gateway"), grp.getgrnam("vcu-gateway")
    assert user.pw_gid == group.gr_gid
    assert 0 < user.pw_uid < 1000
    assert user.pw_shell == "/usr/sbin/nologin"


def test_its_files_are_as_packed_and_using_it_writes_none(ready):
    status = CONFIG.stat()
    assert (status.st_uid, status.st_gid, oct(status.st_mode)) == (0, 0, "0o100644")
    for verb in (["version"], ["check-config"], ["schema", "--api"], ["watch", "--help"]):
        subprocess.run(["vcu-gateway", *verb], check=True, stdout=subprocess.DEVNULL)
    assert output("dpkg", "--verify", PACKAGE) == ""
    packed = set(output("dpkg", "-L", PACKAGE).split("\n"))
    assert {str(path) for path in HOME.rglob("*")} <= packed


def test_a_foreign_python_path_does_not_matter(ready, tmp_path):
    (tmp_path / "click.py").write_text("raise SystemExit('the wrong one')")
    found = subprocess.run(
        ["vcu-gateway", "version"], env={"PYTHONPATH": str(tmp_path), "PATH": "/usr/bin"}
    )
    assert found.returncode == 0


def test_the_service_runs_from_it(running):
    assert os.stat(f"/proc/{running}").st_uid == pwd.getpwnam("vcu-gateway").pw_uid
    assert os.readlink(f"/proc/{running}/exe") == PYTHON
    until(lambda: "mode" in why(), "an answer")


@pytest.mark.slow
def test_an_upgrade_restarts_an_instance_too(revision_1, ready):
    SECOND.write_text(
        "bus: {channel: vcan0}\napi: {socket_path: /run/vcu-gateway-second/control.sock}\n"
    )
    assert output("systemctl", "start", INSTANCE) == ""
    before = show(INSTANCE, "MainPID")
    install("VCU_DEB_NEXT")
    assert show(INSTANCE, "ActiveState") == "active"
    assert show(INSTANCE, "MainPID") not in ("0", before)
    assert show(SERVICE, "ActiveState") == "inactive"
    remove()
    assert show(INSTANCE, "ActiveState") == "inactive"
    shutil.rmtree("/run/vcu-gateway-second")  # which is kept, as the service's own


@pytest.mark.slow
def test_an_upgrade_neither_starts_nor_enables_what_somebody_disabled(revision_1, ready):
    output("systemctl", "disable", SERVICE)
    install("VCU_DEB_NEXT")
    found = show(SERVICE, "UnitFileState"), show(SERVICE, "ActiveState")
    assert found == ("disabled", "inactive")


def refused(change: list[str], attempts: int = 3) -> str:
    """What apt says while the gateway is active.

    On a busy machine the gateway's tick may be late while apt works, or the demand: then the drive
    ends, and a gateway that is not active is rightly no reason to refuse. Such an attempt says
    nothing.
    """
    for _ in range(attempts):
        with demanding():
            until(armed, "active")
            since_s, pid = time.time(), show(SERVICE, "MainPID")
            done = apt(*change)
            if done.returncode != 0:
                assert show(SERVICE, "MainPID") == pid
                return done.stdout
        assert ended_by_itself(since_s), f"{done.stdout}\n{journal('--lines=200')}"
        install("VCU_DEB")
        CONFIG.write_text(PACKAGED.read_text().replace("channel: can0\n", "channel: vcan0\n"))
        output("systemctl", "restart", SERVICE)
    pytest.fail(f"the gateway did not stay active in {attempts} attempts")


def armed() -> bool:
    """Whether it is active; from FAULT and STANDBY it is brought there."""
    mode = why().get("mode")
    if mode in ("fault", "standby"):
        output("vcu-gateway", "reset", "--level", "service")
        output("vcu-gateway", "arm")
    return mode == "active"


def test_nothing_changes_while_it_is_active_and_once_disarmed_it_upgrades_what_runs(healthy):
    for change in (
        ["install", os.environ["VCU_DEB_NEXT"]],
        ["remove", PACKAGE],
        ["purge", PACKAGE],
    ):
        said = refused(change)
        assert "refused, the gateway is active and may be driving" in said, journal()
        assert "say `vcu-gateway disarm`" in said
        assert installed()[0].endswith(" ok installed")
        assert installed()[1] == "1"
    pid, changed = show(SERVICE, "MainPID"), CONFIG.read_text()
    subprocess.run(["vcu-gateway", "disarm"], check=True, stdout=subprocess.DEVNULL)
    said = install("VCU_DEB_NEXT")
    assert "doctor" not in said
    assert installed() == ("install ok installed", "2")
    assert CONFIG.read_text() == changed
    assert [path.name for path in CONFIG.parent.iterdir()] == ["gateway.yaml"]
    assert show(SERVICE, "ActiveState") == "active"
    assert show(SERVICE, "MainPID") not in ("0", pid)


@pytest.mark.slow
def test_a_stopped_process_that_cannot_answer_is_no_reason_to_refuse(revision_1, running):
    # Without the watchdog, which would end it before dpkg gets there.
    output("systemctl", "service-watchdogs", "no")
    try:
        os.kill(running, 19)
        install("VCU_DEB_NEXT")
    finally:
        output("systemctl", "service-watchdogs", "yes")
    assert installed()[1] == "2"


@pytest.fixture
def recording(running: int) -> int:
    """The recorder runs too, and has a folder; its process."""
    assert output("systemctl", "start", RECORDER) == ""
    until((RECORDINGS / "drives").exists, "its folder")
    return int(show(RECORDER, "MainPID"))


def test_removal_stops_it_and_leaves_configuration_and_recordings_alone(running, recording):
    remove()
    assert installed()[0] == "deinstall ok config-files"
    assert not Path(f"/proc/{running}").exists()
    assert not Path(f"/proc/{recording}").exists()
    for unit in (SERVICE, RECORDER, RECORDER_SOCKET):
        assert show(unit, "LoadState") == "not-found"
    kept = {"/etc/vcu-gateway", "/var/lib/vcu-gateway", "/run/vcu-gateway", str(RECORDINGS)}
    assert named_after_it() - NOTES_OF_SYSTEMD == kept
    assert [path.name for path in CONFIG.parent.iterdir()] == ["gateway.yaml"]


# So that a unit that was disabled stays so when the package comes back.
NOTES_OF_SYSTEMD = {
    "/etc/systemd/system/multi-user.target.wants/vcu-gateway.service",
    "/var/lib/systemd/deb-systemd-helper-enabled/multi-user.target.wants/vcu-gateway.service",
    "/var/lib/systemd/deb-systemd-helper-enabled/vcu-gateway.service.dsh-also",
    "/var/lib/systemd/deb-systemd-helper-enabled/vcu-gateway-exporter.service.dsh-also",
    "/var/lib/systemd/deb-systemd-helper-enabled/vcu-gateway-pedals.service.dsh-also",
    "/var/lib/systemd/deb-systemd-helper-enabled/vcu-gateway-recorder.service.dsh-also",
    "/var/lib/systemd/deb-systemd-helper-enabled/vcu-gateway-web.service.dsh-also",
    "/var/lib/systemd/deb-systemd-helper-enabled/vcu-gateway-recorder.socket.dsh-also",
    *(
        f"{folder}/{wanting}.wants/vcu-gateway-recorder.socket"
        for folder in ("/etc/systemd/system", "/var/lib/systemd/deb-systemd-helper-enabled")
        for wanting in ("sockets.target", "vcu-gateway.service", "vcu-gateway@.service")
    ),
    *(
        f"{folder}/{name}.wants"
        for folder in ("/etc/systemd/system", "/var/lib/systemd/deb-systemd-helper-enabled")
        for name in ("vcu-gateway.service", "vcu-gateway@.service")
    ),
}


def test_purging_leaves_nothing_but_the_users(running, recording):
    remove("purge")
    assert not RECORDINGS.exists()
    assert named_after_it() == set()
    assert pwd.getpwnam("vcu-gateway")


@pytest.mark.slow
def test_after_a_removal_it_comes_back_as_it_was(running):
    changed = CONFIG.read_text()
    remove()
    install("VCU_DEB")
    assert CONFIG.read_text() == changed
    assert (show(SERVICE, "UnitFileState"), show(SERVICE, "ActiveState")) == ("enabled", "inactive")
