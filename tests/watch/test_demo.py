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

import pytest

from tests.watch.terminals import ROOT, VCU_GATEWAY, window
from vcu_gateway.client import Client
from vcu_gateway.demo.process import DemoOptions, DemoProcess
from vcu_gateway.drive_format import layout
from vcu_gateway.errors import GatewayError
from vcu_gateway.recordings import RecordingFolder, check_recording

WAIT_S = 60.0
IN_PROCESS = DemoOptions("virtual", "in-process", 30.0, 20.0, None)


@pytest.fixture
def folder(monkeypatch) -> Iterator[Path]:
    """Where temporary files go; short, for the sockets in it."""
    made = Path(tempfile.mkdtemp(prefix="vcu."))
    monkeypatch.setenv("TMPDIR", str(made))
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


def demo(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "vcu_gateway", "demo", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)


def first_pid(process: subprocess.Popen[str]) -> int:
    """The gateway's own, from the first view."""
    assert process.stdout is not None
    return int(re.search(r"pid (\d+)", process.stdout.readline())[1])


@pytest.mark.clock
def test_in_a_terminal_it_shows_the_drive_and_ends_with_a_summary(folder):
    with window() as shell:
        shell.type(f"clear; TMPDIR={folder} {VCU_GATEWAY} demo; echo exit=$?")
        screen = shell.until(r"^ ACTIVE  demand of bench; drive; disarm to end")
        assert screen.startswith("vcu-gateway demo  ")
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


def test_a_reader_that_goes_away_ends_it_quietly(folder):
    done = subprocess.run(
        f"{VCU_GATEWAY} demo | head -1",
        shell=True,
        capture_output=True,
        text=True,
        timeout=60,
        cwd=ROOT,
    )
    assert done.stdout.startswith("vcu-gateway demo  ")
    assert done.stderr == ""
    assert list(folder.iterdir()) == []


def test_its_api_answers_as_that_of_any_gateway_for_this_user_alone(folder):
    with DemoProcess(IN_PROCESS) as child, Client(child.socket_path) as client:
        assert client.health()["link"]["interface"] == "virtual"
        assert child.socket_path.stat().st_mode & 0o777 == 0o600
        assert child.socket_path.parent.stat().st_mode & 0o777 == 0o700
        assert child.summary == ""
    assert "command frames sent" in child.summary


def test_its_duration_ends_it(folder):
    with DemoProcess(IN_PROCESS._replace(duration_s=1.5)) as child:
        until(child.has_ended)
    done, skipped = map(int, re.findall(r"(\d+) (?:ticks|skipped)", child.summary))
    assert done <= 36
    assert done + skipped >= 30, "a machine that stands still may miss more at the end"
    assert list(folder.iterdir()) == []


def test_a_child_that_cannot_start_says_why_with_its_exit_code(folder):
    with pytest.raises(GatewayError, match=r"throttle_pct.*200") as caught:
        DemoProcess(IN_PROCESS._replace(throttle_pct=200.0))
    assert caught.value.exit_code == 78
    with pytest.raises(GatewayError, match="cannot open socketcan none") as caught:
        DemoProcess(IN_PROCESS._replace(interface="socketcan", channel="none"))
    assert caught.value.exit_code == 69
    assert list(folder.iterdir()) == []


def test_a_child_that_stands_still_is_killed_and_reported_as_a_bug(folder, monkeypatch):
    monkeypatch.setattr("vcu_gateway.demo.process._PATIENCE_S", 0.5)
    child = DemoProcess(IN_PROCESS)
    with Client(child.socket_path) as client:
        pid = client.health()["pid"]
    os.kill(pid, signal.SIGSTOP)
    with pytest.raises(GatewayError, match="it ended with -9") as caught, child:
        pass
    assert caught.value.exit_code == os.EX_SOFTWARE
    assert is_gone(pid)


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
    with DemoProcess(IN_PROCESS) as child, Client(child.socket_path) as client:
        assert client.config()["values"]["recorder"]["socket_path"] is None
