"""A foreign log replayed: decisions on its frames alone, and said so."""

import gzip
import json
import subprocess
import sys
from pathlib import Path

import can
import pytest

from tests.export_libraries import PATIENCE_S, export_folder, with_export_libraries
from tests.replay.drives import CODEC
from tests.replay.ran import replay
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.replay.commands import RecordedCommands

__all__ = ["export_folder"]

LOGS = Path(__file__).parents[1] / "logs"
DRIVE = LOGS / "drive.log"


@pytest.fixture(scope="session")
def log(recorded, tmp_path_factory) -> Path:
    """The frames of a drive as a log of any bus: nothing else is known of it."""
    path = tmp_path_factory.mktemp("log") / "drive.log"
    frames = [gzip.decompress(one.read_bytes()) for one in recorded["ordinary"].glob("*.log.gz")]
    path.write_bytes(b"".join(frames))
    return path


def test_a_log_is_decided_on_a_grid_of_50_ms_and_says_what_that_means(log):
    ran = replay(log)
    assert ran.code == 0
    assert "with a tick every 50 ms" in ran.out
    assert "no reaction time is judged" in ran.out
    assert "no demand is known, so nobody arms" in ran.out
    assert "\n  11:06:41.150  standby\n" in ran.out
    assert "active" not in ran.out.partition("modes\n")[2].partition("causes")[0]


def test_a_demand_drives_from_standby_on(log):
    ran = replay(log, "--demand", "30", "--json")
    modes = [one["mode"] for one in ran.values["decisions"]["modes"]]
    assert modes == ["starting", "standby", "active"]
    assert ran.values["decisions"]["stops"] == [], "recorded commands are what controllers echo"


def test_what_if_on_a_log_compares_two_configurations(log):
    sets = ("--set", "limits.power_limit_max_w=5000")
    ran = replay(log, "--demand", "30", *sets, "--json")
    assert ran.code == 1
    assert {one["field"] for one in ran.values["what_if"]["fields"]} == {"PowerLimit"}
    assert replay(log, "--demand", "30", "--set", "limits.derated_power_w=5000").code == 0


def test_the_configuration_of_a_log_is_that_of_the_file(log, tmp_path):
    config = tmp_path / "gateway.yaml"
    config.write_text("safety:\n  listen_before_talk_ms: 3000\n")
    told = replay(log, "-c", config, "--json").values["decisions"]["modes"]
    assert told[1] == {"time": "2026-11-18T11:06:43.050Z", "mode": "standby"}


def test_a_part_of_a_log_is_replayed(log):
    ran = replay(log, "--from", "2", "--to", "4", "--json")
    assert ran.values["ticks"] in (40, 41)


def test_a_long_pause_is_left_out_and_told(log, tmp_path):
    lines = log.read_text().splitlines()
    later = [line.replace("(1795000", "(1795009", 1) for line in lines[:2000]]
    path = tmp_path / "twice.log"
    path.write_text("\n".join([*lines, *later, ""]))
    ran = replay(path)
    assert "there is no frame; everything begins anew" in ran.out
    assert len([line for line in ran.out.splitlines() if line.endswith("  starting")]) == 2


@pytest.mark.parametrize("suffix", [".blf", ".asc"])
def test_other_formats_are_replayed_too(tmp_path, suffix):
    path = tmp_path / f"drive{suffix}"
    with can.Logger(str(path)) as writer:
        for message in can.LogReader(str(DRIVE)):
            writer(message)
    found = replay(path, "--json").values
    expected = replay(DRIVE, "--json").values
    assert found["frames"] == expected["frames"]
    assert abs(found["ticks"] - expected["ticks"]) <= 1
    assert [one["mode"] for one in found["decisions"]["modes"]] == ["starting", "standby"]


WRITE_MF4 = """
import sys, can
with can.Logger(sys.argv[2]) as writer:
    for message in can.LogReader(sys.argv[1]):
        message.channel = 0
        writer(message)
"""


@pytest.mark.ci
@pytest.mark.timeout(PATIENCE_S)
def test_mf4_is_replayed_where_asammdf_is_installed(export_folder, tmp_path):
    path, environment = tmp_path / "drive.mf4", with_export_libraries(export_folder)
    write = [sys.executable, "-c", WRITE_MF4, str(DRIVE), str(path)]
    subprocess.run(write, check=True, env=environment, timeout=90)
    command = [sys.executable, "-m", "vcu_gateway", "replay", str(path), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=90)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["frames"] == replay(DRIVE, "--json").values["frames"]


def test_an_empty_log_and_options_that_do_not_fit_are_refused(tmp_path, recorded):
    empty = tmp_path / "empty.log"
    empty.write_text("")
    assert replay(empty).code == 65
    assert replay(DRIVE, "--closed-loop").code == 2
    assert replay(recorded["ordinary"], "--demand", "30").code == 2
    assert replay(DRIVE, "--from", "noon").code == 2


def test_a_told_command_is_what_the_core_would_have_kept_of_it():
    told = RecordedCommands(CODEC)
    gateway = Gateway(CODEC, Settings(), 0)
    for raw in range(256):
        for first in (0x04, 0x14):
            data = bytes((first, raw, 0, 0, 0xE0, 0x2E, 0, 0))
            gateway.sent(OutFrame("PCU1", 0x0008A7D0, data), True, raw)
            assert gateway.transmitter.history.frames["PCU1"][-1] == told.of("PCU1", data, raw)


def test_another_sender_in_a_log_is_another_sender(log, tmp_path):
    foreign = Frame(0x0008A7D1, bytes(8), 0)
    line = f"(1795000005.000000000) can0 {foreign.can_id:08X}#{foreign.data.hex()} R"
    path = tmp_path / "foreign.log"
    lines = log.read_text().splitlines()
    place = next(n for n, one in enumerate(lines) if one.startswith("(1795000005."))
    path.write_text("\n".join([*lines[:place], line, *lines[place:], ""]))
    causes = replay(path, "--json").values["decisions"]["causes"]
    assert "foreign_sender" in {one["cause"] for one in causes}
