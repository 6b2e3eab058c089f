"""Incidents: what surrounds a fault stays, whatever the ring removes."""

import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time

import pytest

from tests.recorder.gateway import account, core_lines, drives, incidents
from vcu_gateway.recording import layout

SHORT = ("--incident-before-s", "60", "--incident-after-s", "1.5")


def wait_for_incidents(folder, count, timeout_s=60.0):
    end_s = time.monotonic() + timeout_s
    while len(incidents(folder)) < count and time.monotonic() < end_s:
        time.sleep(0.02)
    return incidents(folder)


def numbers(folder):
    return [segment.number for segment in layout.segments(folder)]


def lines_of(folder):
    return [line for segment in layout.segments(folder) for line in core_lines(segment)]


@pytest.mark.clock
def test_a_latched_fault_has_its_incident_with_both_sides(recorder, gateway, tmp_path):
    process = recorder(*SHORT)
    vehicle = gateway()
    vehicle.drive(0.6)
    vehicle.begin_segment()
    vehicle.drive(0.6)
    vehicle.latch("undervoltage")
    (incident,) = wait_for_incidents(tmp_path, 1)
    assert incident.name.endswith("Z-undervoltage")
    assert numbers(incident) == [1, 2]
    vehicle.drive(0.5)
    vehicle.begin_segment()
    vehicle.drive(2)
    vehicle.begin_segment()
    vehicle.drive(0.5)
    assert process.stop() == 0
    assert numbers(incident) == [1, 2, 3]
    (drive,) = drives(tmp_path)
    assert os.path.samefile(incident / "0002.core.jsonl.gz", drive / "0002.core.jsonl.gz")
    for name in ("drive.json", "config.yaml", "vcu.dbc"):
        assert (incident / name).read_bytes() == (drive / name).read_bytes()
    told = json.loads((incident / "incident.json").read_text())
    assert (told["reason"], told["kind"]) == ("fault_latched", "undervoltage")
    assert told["what"] == "fault latched: battery undervoltage: cut"
    assert (told["before_s"], told["after_s"]) == (60, 1.5)
    assert (told["drive"], told["run"]) == (drive.name, vehicle.run)
    latched = [line for line in lines_of(incident) if "events" in line]
    assert len(latched) == 1


def test_an_incident_holds_what_it_held_when_the_recorder_is_killed(recorder, gateway, tmp_path):
    process = recorder(*SHORT)
    vehicle = gateway()
    vehicle.drive(0.5)
    vehicle.latch()
    (incident,) = wait_for_incidents(tmp_path, 1)
    vehicle.drive(0.5)
    process.kill()
    assert [line for line in lines_of(incident) if "events" in line]


@pytest.mark.ci
@pytest.mark.clock
def test_what_comes_while_an_incident_is_open_joins_it(recorder, gateway, tmp_path):
    process = recorder(*SHORT)
    vehicle = gateway()
    vehicle.drive(0.2)
    vehicle.latch("undervoltage")
    vehicle.drive(1)
    vehicle.tick(more='{"f":0,"estop":true,"granted":true}\n')
    vehicle.drive(1)
    vehicle.begin_segment()
    vehicle.drive(0.5)
    assert process.stop() == 0
    (incident,) = incidents(tmp_path)
    files = layout.incident_files(incident)
    assert [path.name for path in files] == ["incident.json", "incident-2.json"]
    assert json.loads(files[1].read_text())["reason"] == "emergency_stop"
    assert numbers(incident) == [1, 2]


def test_an_unexpected_restart_keeps_the_end_of_the_drive_before(recorder, gateway, tmp_path):
    process = recorder(*SHORT)
    before = gateway()
    before.drive(0.5)
    before.close()
    after = gateway()
    after.tick(more='{"f":0,"restarted":1}\n')
    after.drive(0.5)
    both = wait_for_incidents(tmp_path, 2)
    assert process.stop() == 0
    first, second = sorted(both, key=lambda one: one.name.endswith("-before"))
    # Each is named by its own second.
    assert first.name.partition("-")[2] == "restarted_unexpectedly"
    assert second.name.partition("-")[2] == "restarted_unexpectedly-before"
    runs = [layout.read_description(one / "drive.json")["run"] for one in (first, second)]
    assert runs == [after.run, before.run]
    assert numbers(second) == [1]


def test_a_start_that_nothing_unexpected_preceded_is_no_incident(recorder, gateway, tmp_path):
    process = recorder(*SHORT)
    vehicle = gateway()
    vehicle.tick(more='{"f":0,"restarted":0}\n')
    vehicle.drive(0.5)
    assert process.stop() == 0
    assert incidents(tmp_path) == []


def test_somebody_may_ask_to_keep_this_moment(recorder, gateway, tmp_path):
    process = recorder(*SHORT)
    vehicle = gateway()
    vehicle.drive(0.5)
    process.process.send_signal(signal.SIGUSR1)
    (incident,) = wait_for_incidents(tmp_path, 1)
    assert incident.name.endswith("-requested")
    for _ in range(10_000):  # some come while another is being answered
        process.process.send_signal(signal.SIGUSR1)
    vehicle.drive(0.2)
    assert process.stop() == 0


@pytest.fixture
def faults(recorder, gateway, tmp_path):
    """Faults one after the other, each an incident of its own of about 60 KiB."""
    options = ("--incident-before-s", "0", "--incident-after-s", "0")

    def begin(budget):
        process = recorder(*options, "--incident-max-bytes", str(budget))
        vehicle = gateway()
        latched = itertools.count(1)

        def latch(cause):
            before, number = set(incidents(tmp_path)), next(latched)
            vehicle.begin_segment()
            vehicle.drive(0.05, frames=5000)
            vehicle.latch(cause)

            def is_kept(status):
                told = status["incidents"] + status["totals"]["removed_incidents"]
                return told >= number or set(incidents(tmp_path)) - before

            process.wait_for(is_kept)

        return process, latch

    return begin


def test_the_first_of_a_kind_is_kept_over_the_twentieth(faults, tmp_path):
    process, latch = faults(400_000)
    latch("overspeed")
    latch("undervoltage")
    (first_undervoltage,) = (one for one in incidents(tmp_path) if "undervoltage" in one.name)
    for cause in [*["undervoltage"] * 19, "overheated"]:
        latch(cause)
    status = process.wait_for(lambda status: status["totals"]["removed_incidents"] > 5)
    assert process.stop() == 0
    kinds = [layout.read_description(one / "incident.json")["kind"] for one in incidents(tmp_path)]
    assert kinds.count("overspeed") == kinds.count("overheated") == 1
    assert 1 <= kinds.count("undervoltage") < 10
    assert first_undervoltage in incidents(tmp_path)
    assert status["incidents_bytes"] < 600_000


def test_an_incident_that_somebody_keeps_is_not_removed(faults, tmp_path):
    process, latch = faults(150_000)
    latch("undervoltage")
    latch("undervoltage")
    kept = incidents(tmp_path)[1]
    (kept / layout.KEEP_FILE).touch()
    for _ in range(6):
        latch("undervoltage")
    assert process.stop() == 0
    assert kept in incidents(tmp_path)
    assert len(incidents(tmp_path)) < 6


def keep_now(process, *options, code=0):
    command = [sys.executable, "-m", "vcu_gateway", "recordings", "keep", "now", *options]
    command += ["--folder", process.folder, "--status", process.status_path]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False)
    assert done.returncode == code, done
    return done


def reasons(incident):
    return [layout.read_description(path)["what"] for path in layout.incident_files(incident)]


def test_what_somebody_asks_to_keep_has_his_reason(recorder, gateway, tmp_path):
    process = recorder("--incident-after-s", "60")
    vehicle = gateway()
    vehicle.drive(0.5)
    process.wait_for(lambda status: status["connections"])
    name = keep_now(process, "--reason", "it swerved\n\x1b[31m").stdout.strip()
    (incident,) = incidents(tmp_path)
    assert incident.name == name
    assert reasons(incident) == ["it swerved  [31m"]
    assert keep_now(process).stdout.strip() == name, "the incident that is open takes it in"
    assert reasons(incident) == ["it swerved  [31m", "somebody asked to keep this"]


def test_where_no_gateway_is_connected_there_is_nothing_to_keep(recorder, tmp_path):
    process = recorder(*SHORT)
    process.wait_for(lambda status: status["pid"])
    assert "no gateway is connected" in keep_now(process, "--reason", "now", code=69).stderr
    assert incidents(tmp_path) == []


def test_incidents_on_another_file_system_are_told_and_cost_nothing_else(
    recorder, gateway, tmp_path
):
    with tempfile.TemporaryDirectory(dir="/dev/shm") as elsewhere:
        if os.stat(elsewhere).st_dev == tmp_path.stat().st_dev:
            pytest.skip("one file system")
        (tmp_path / "recordings").mkdir()
        (tmp_path / "recordings" / "incidents").symlink_to(elsewhere)
        process = recorder(*SHORT)
        vehicle = gateway()
        vehicle.drive(0.3)
        vehicle.latch()
        vehicle.drive(1.5)
        vehicle.latch()
        vehicle.drive(1.5)
        assert process.status["disk"] == "ok"
        vehicle.close()
        assert process.stop() == 0
    assert process.errors.count("no incident can be kept") == 1
    assert account(drives(tmp_path)[0]) == (vehicle.frames, 0)
