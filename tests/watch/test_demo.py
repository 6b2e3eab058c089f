"""`vcu-gateway demo`: a gateway that drives, shown as a real one is, and nothing left behind."""

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.watch.terminals import ROOT, VCU_GATEWAY, window
from vcu_gateway.client import Client
from vcu_gateway.config import Config
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.demo.process import DemoOptions, DemoProcess, default_socket
from vcu_gateway.demo.process import load as load_demo
from vcu_gateway.errors import GatewayError
from vcu_gateway.recording import layout
from vcu_gateway.recording.check import check_recording
from vcu_gateway.recording.folder import RecordingFolder
from vcu_gateway.simulator.scenario import Scenario

WAIT_S = 60.0
PRESSED = ((5.0, 0), (5.1, 43), (9.9, 43), (10.0, 0))  # s, % of the travel
SCENARIOS = ROOT / "config" / "scenarios"


@pytest.fixture
def folder(monkeypatch) -> Iterator[Path]:
    """Where temporary files and the demo's socket go; short, for the sockets in it."""
    made = Path(tempfile.mkdtemp(prefix="vcu."))
    monkeypatch.setenv("TMPDIR", str(made))
    monkeypatch.setattr(tempfile, "tempdir", None)  # which it remembers
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    yield made
    shutil.rmtree(made)


def until(condition) -> None:
    end_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def is_gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except OSError:
        return True


def in_process() -> DemoOptions:
    return DemoOptions("virtual", "in-process", str(default_socket()))


def demo(*arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "vcu_gateway", "demo", *map(str, arguments)]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True, cwd=ROOT)


def until_said(process: subprocess.Popen[str], pattern: str) -> re.Match[str]:
    """The next line of this form."""
    assert process.stdout is not None
    for line in process.stdout:
        if found := re.search(pattern, line):
            return found
    raise AssertionError(f"{pattern} did not come")


def first_pid(process: subprocess.Popen[str]) -> int:
    """The gateway's own, from the first view."""
    return int(until_said(process, r"pid (\d+)")[1])


def socket_named(process: subprocess.Popen[str]) -> Path:
    """The gateway's, from the line to be typed in another terminal."""
    return Path(until_said(process, r"^  export VCU_GATEWAY_SOCKET=(\S+)$")[1])


@pytest.mark.clock
def test_in_a_terminal_it_shows_the_drive_and_ends_with_a_summary(folder):
    with window() as shell:
        shell.type(f"clear; TMPDIR={folder} {VCU_GATEWAY} demo; echo exit=$?")
        screen = shell.until(r"^demand of bench; drive; disarm to end")
        assert screen.startswith("vcu-gateway demo  ")
        assert f"\nexport VCU_GATEWAY_SOCKET={folder}/vcu-gateway-demo-" in screen
        shell.until(r"throttle % +30\.0 +30\.0 +30\.0 +30\.0")
        shell.until(r"speed rpm +max 12000 +[1-9]\d* +max 12000 +[1-9]")
        shell.press("d", "D")
        shell.until(r"^ STANDBY ")
        shell.press("q")
        screen = shell.until(r"^exit=0")
        assert re.search(r"^\d+ ticks, \d+ skipped, \d+ command frames sent", screen, re.MULTILINE)
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_without_a_terminal_a_signal_ends_it_with_a_summary(folder, number):
    process = demo()
    pid = first_pid(process)
    process.send_signal(number)
    output, _ = process.communicate(timeout=WAIT_S)
    assert process.returncode == 0
    assert re.search(r"\d+ ticks, \d+ skipped, \d+ command frames sent", output.splitlines()[-1])
    assert is_gone(pid)
    assert list(folder.iterdir()) == []


def test_the_gateway_does_not_outlive_a_view_that_is_killed(folder):
    process = demo()
    pid = first_pid(process)
    process.kill()
    process.communicate(timeout=WAIT_S)
    until(lambda: is_gone(pid))
    assert list(folder.iterdir()) == []


@pytest.mark.ci
def test_a_reader_that_goes_away_ends_it_quietly(folder):
    done = subprocess.run(
        f"{VCU_GATEWAY} demo | head -1",
        shell=True,
        capture_output=True,
        text=True,
        timeout=60,
        cwd=ROOT,
    )
    assert done.stdout.startswith("vcu-gateway demo on ")
    assert done.stderr == ""
    assert list(folder.iterdir()) == []


def test_its_api_answers_as_that_of_any_gateway_for_this_user_alone(folder):
    with DemoProcess(in_process()) as child, Client(child.socket_path) as client:
        assert client.health()["link"]["interface"] == "virtual"
        assert child.socket_path.stat().st_mode & 0o777 == 0o600
        assert child.summary == ""
    assert "command frames sent" in child.summary


def test_its_duration_ends_it(folder):
    with DemoProcess(in_process()._replace(duration_s=1.5)) as child:
        until(child.has_ended)
    done, skipped = map(int, re.findall(r"(\d+) (?:ticks|skipped)", child.summary))
    assert done <= 36
    assert done + skipped >= 30, "a machine that stands still may miss more at the end"
    assert list(folder.iterdir()) == []


def test_a_child_that_cannot_start_says_why_with_its_exit_code(folder):
    config = folder / "bad.yaml"
    config.write_text("limits: {throttle_slew_pct_per_s: 7000}\n")
    with pytest.raises(GatewayError, match=r"bad.yaml:1: limits.throttle_slew") as caught:
        DemoProcess(in_process()._replace(config_path=str(config)))
    assert caught.value.exit_code == 78
    config.unlink()
    with pytest.raises(GatewayError, match="cannot open socketcan none") as caught:
        DemoProcess(in_process()._replace(interface="socketcan", channel="none"))
    assert caught.value.exit_code == 69
    assert list(folder.iterdir()) == []


def test_a_child_that_stands_still_is_killed_and_reported_as_a_bug(folder, monkeypatch):
    monkeypatch.setattr("vcu_gateway.demo.process._PATIENCE_S", 0.5)
    child = DemoProcess(in_process())
    with Client(child.socket_path) as client:
        pid = client.health()["pid"]
    os.kill(pid, signal.SIGSTOP)
    with pytest.raises(GatewayError, match="it ended with -9") as caught, child:
        pass
    assert caught.value.exit_code == os.EX_SOFTWARE
    assert is_gone(pid)


@pytest.mark.ci
def test_a_recorded_demo_is_whole_and_says_what_to_do_next(folder):
    process = demo("--duration", "4", "--record", str(folder / "kept"))
    said, _ = process.communicate(timeout=WAIT_S)
    assert process.returncode == 0
    (drive,) = layout.recorded_folders(folder / "kept" / layout.DRIVES)
    assert f"recorded in {drive}; next:" in said
    assert f"  vcu-gateway replay {drive}\n" in said
    recording = RecordingFolder(folder / "kept").named(drive.name)
    found = check_recording(recording, lambda size: None)
    assert found.is_whole, found
    assert not found.is_cut_off
    assert found.frames > 300
    assert {path.name for path in folder.iterdir()} == {"kept"}


def test_a_folder_that_cannot_be_written_is_told_before_anything_is_shown(folder):
    (folder / "file").touch()
    process = demo("--duration", "4", "--record", str(folder / "file" / "inside"))
    assert process.wait(WAIT_S) == 69
    assert process.stdout is not None
    assert process.stdout.read() == ""


def test_a_demo_that_is_not_recorded_hands_nothing_to_a_recorder_of_the_machine(folder):
    with DemoProcess(in_process()) as child, Client(child.socket_path) as client:
        assert client.config()["values"]["recorder"]["socket_path"] is None


@pytest.mark.ci
def test_the_socket_is_the_same_each_time_and_a_second_demo_does_not_take_it(folder, monkeypatch):
    named = folder / f"vcu-gateway-demo-{os.geteuid()}.sock"
    assert default_socket() == named
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))
    assert default_socket() == folder / "vcu-gateway-demo.sock"
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    with DemoProcess(in_process()) as first, Client(first.socket_path) as client:
        with pytest.raises(GatewayError, match=f"another process answers at {named}.*--socket"):
            DemoProcess(in_process())
        own = str(folder / "other.sock")
        with DemoProcess(in_process()._replace(socket_path=own)), Client(own) as second:
            assert second.health()["pid"] != client.health()["pid"]
        assert client.health()["pid"]
    assert list(folder.iterdir()) == []


@pytest.mark.ci
@pytest.mark.clock
def test_it_drives_a_configuration_through_a_scenario_and_keeps_what_happened(folder):
    config, scenario, kept = folder / "own.yaml", folder / "scenario.yaml", folder / "kept"
    config.write_text(
        "bus: {channel: can7}\napi: {operator_groups: [drivers-of-mars]}\n"
        "limits: {speed_limit_max_rpm: 3000}\n"
    )
    scenario.write_text("steps:\n  - {at_s: 1.5, fault: silence, of: IMU}\n")
    process = demo("-c", config, "--scenario", scenario, "--record", kept)
    socket = socket_named(process)
    assert socket.parent == folder
    until_said(process, r"^scenario, 1\.5 s: silence of IMU begins$")
    with Client(socket) as client:
        until(lambda: client.why()["mode"] == "active")
        until(lambda: "IMU_Attitude" in client.why()["sentence"])
        commanded = client.state()["commands"]["PCU1"]
        assert commanded["speed_limit_rpm"] == 3000
        assert client.config()["values"]["bus"]["channel"] in ("in-process", "vcan0")
    command = [sys.executable, "-m", "vcu_gateway", "recordings", "keep", "now"]
    command += ["--folder", str(kept), "--reason", "no IMU"]
    keeping = subprocess.run(command, capture_output=True, text=True, timeout=WAIT_S)
    assert keeping.returncode == 0, keeping.stderr
    process.send_signal(signal.SIGINT)
    output, errors = process.communicate(timeout=WAIT_S)
    assert (process.returncode, errors) == (0, "")
    assert "recorded in" in output
    (incident,) = layout.recorded_folders(kept / layout.INCIDENTS)
    assert incident.name == keeping.stdout.strip()
    assert layout.read_description(incident / layout.INCIDENT_FILE)["what"] == "no IMU"
    assert sorted(path.name for path in kept.iterdir()) == ["drives", "incidents"]


@pytest.mark.parametrize(
    ("option", "text", "said"),
    [
        ("--scenario", "steps:\n  - {at_s: 1, fault: silense}\n", "bad.yaml:2: "),
        ("--scenario", "foot: {brake_pct: [[0, 0], [1, 9]]}\n", "bad.yaml: foot needs the pedals"),
        ("-c", "bus: {}\nlimits: {speed_limit_max_rpm: -1}\n", "bad.yaml:2: limits.speed"),
        ("-c", "freshness: {stale_after_ms: {BMS: 1}}\n", 'bad.yaml:1: .* no message "BMS"'),
        ("--scenario", None, "bad.yaml: there is no such file"),
        ("-c", None, "bad.yaml: there is no such file"),
    ],
)
def test_a_wrong_file_is_an_error_and_nothing_is_started(folder, option, text, said):
    path = folder / "bad.yaml"
    if text is not None:
        path.write_text(text)
    process = demo(option, path, "--record", folder / "kept")
    output, errors = process.communicate(timeout=WAIT_S)
    assert process.returncode in (os.EX_CONFIG, os.EX_NOINPUT, os.EX_DATAERR)
    assert output == ""
    assert re.search(rf"^error: {folder}/{said}", errors)
    assert {path.name for path in folder.iterdir()} <= {"bad.yaml"}


def loaded(**options: Any) -> tuple[Config, ProtocolSpec, Scenario]:
    return load_demo(in_process()._replace(**options))


def test_the_demand_is_the_configurations_else_the_demos_or_nobodys(tmp_path):
    (tmp_path / "bench.yaml").write_text(
        "bench: {demand: {bench_use_only: true, throttle_pct: 7, power_mode: eco}}\n"
    )
    (tmp_path / "limits.yaml").write_text("limits: {speed_limit_max_rpm: 900}\n")
    bench, limits = str(tmp_path / "bench.yaml"), str(tmp_path / "limits.yaml")

    def demanded(**options: Any) -> tuple[float, str, int, bool] | None:
        bench = loaded(**options)[0].bench
        one = bench.demand
        if one is None:
            return None
        return one.throttle_pct, one.power_mode, one.speed_limit_rpm, bench.model_dump()["auto_arm"]

    assert demanded() == (30, "normal", 12000, True)
    assert demanded(throttle_pct=50.0) == (50, "normal", 12000, True)
    assert demanded(config_path=limits) == (30, "normal", 900, True)
    assert demanded(config_path=bench) == (7, "eco", 12000, False)
    assert demanded(config_path=bench, throttle_pct=9.0) == (9, "eco", 12000, False)
    for path in (None, bench, limits):
        assert demanded(config_path=path, has_demand=False) is None


def test_pedals_are_those_of_the_file_else_of_the_example_and_the_foot_presses_as_asked(tmp_path):
    (tmp_path / "limits.yaml").write_text("limits: {speed_limit_max_rpm: 900}\n")
    (tmp_path / "foot.yaml").write_text("foot: {throttle_pct: [[0, 0], [2, 70]]}\n")
    limits, foot = str(tmp_path / "limits.yaml"), str(tmp_path / "foot.yaml")

    def pressed(**options: Any) -> tuple[tuple[float, float], ...]:
        config, _, scenario = loaded(has_pedals=True, **options)
        assert config.bench.demand is None
        return () if scenario.foot is None else scenario.foot.throttle_pct.points[:5]

    assert pressed() == ((5, 0), (6, 30), (29, 30), (30, 0), (35, 0))
    assert pressed(throttle_pct=50.0) == ((5, 0), (6, 50), (29, 50), (30, 0), (35, 0))
    _, _, scenario = loaded(has_pedals=True)
    assert scenario.foot is not None
    assert scenario.foot.throttle_pct.at(7200) == 30, "it stays pressed after the last round"
    assert pressed(scenario_path=foot) == ((0, 0), (2, 70))
    assert pressed(has_demand=False) == ()
    with pytest.raises(GatewayError, match=r"limits\.yaml: has no pedals\.can, and --pedals needs"):
        loaded(has_pedals=True, config_path=limits)


@pytest.mark.ci
@pytest.mark.clock  # it drives once: a gateway without a processor ends the drive for good
def test_with_pedals_it_arms_once_and_a_foot_drives(folder):
    # Arming may take longer than 5 s, and needs a pedal that is released.
    foot = [[at_s + part_s, pct] for at_s in range(0, 60, 10) for part_s, pct in PRESSED]
    (folder / "foot.yaml").write_text(f"foot: {{throttle_pct: {foot}}}\n")
    process = demo("--pedals", "--scenario", folder / "foot.yaml")
    with Client(socket_named(process)) as client:
        until(lambda: client.why()["mode"] == "active")
        until(lambda: client.state()["commands"]["PCU1"]["throttle_pct"] > 40)
        assert client.why()["demand"]["source"] == "pedals"
        client.disarm()
        until(lambda: client.why()["mode"] == "standby")
        time.sleep(1)  # five times as long as arming again would take
        assert client.why()["mode"] == "standby"
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=WAIT_S)
    assert (process.returncode, errors) == (0, "")


def test_the_batterys_speed_is_the_options_else_the_scenarios_else_twenty(tmp_path):
    path = tmp_path / "fast.yaml"
    path.write_text("start: {battery_speedup: 5}\nsteps: []\n")

    def speedup(**options: Any) -> float:
        return loaded(**options)[2].start.battery_speedup

    assert speedup() == 20
    assert speedup(scenario_path=str(path)) == 5
    assert speedup(scenario_path=str(path), battery_speedup=3.0) == 3
    assert speedup(scenario_path=str(SCENARIOS / "imu-silent.yaml")) == 1
