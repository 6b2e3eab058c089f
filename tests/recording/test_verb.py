"""`vcu-gateway recordings`, as it is typed."""

import hashlib
import json
import os
import pty
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import pytest

from tests.recording.kept import FRAMES, START_S, WrittenDrive, torn
from vcu_gateway.recording import layout

PROGRAM = [sys.executable, "-m", "vcu_gateway", "recordings"]


@pytest.fixture
def drive(tmp_path: Path) -> WrittenDrive:
    """Two whole segments."""
    one = WrittenDrive(tmp_path)
    one.segment()
    one.segment(gap_frames=7)
    return one


AS_NOBODY = """
import os, sys
from vcu_gateway.cli import main, recordings
os.setgroups([]), os.setresgid(65534, 65534, 65534), os.setresuid(65534, 65534, 65534)
sys.argv[1:1] = ["recordings"]
main()
"""


def said(
    drive: WrittenDrive, *words: str, code: int = 0, program: Sequence[str] = PROGRAM
) -> subprocess.CompletedProcess[str]:
    command = [*program, *words, "--folder", str(drive.folder)]
    done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    assert done.returncode == code, done.stdout + done.stderr
    return done


def incident(drive: WrittenDrive, reason: str = "undervoltage") -> Path:
    """Of the drive's first segment."""
    path = drive.folder / layout.INCIDENTS / "20251123T174641Z-fault_latched"
    described = {"format": 1, "reason": "fault_latched", "kind": reason, "what": reason}
    text = json.dumps(described, sort_keys=True, separators=(",", ":")).encode()
    described["digest"] = hashlib.sha256(text).hexdigest()
    names = (layout.DRIVE_FILE, layout.CONFIG_FILE, layout.DBC_FILE)
    files = {name: (drive.path / name).read_bytes() for name in names}
    files[layout.INCIDENT_FILE] = layout.description_bytes(described)
    layout.create_folder(path, files, layout.segments(drive.path)[0].paths)
    return path


def test_the_list_names_drives_and_incidents_with_duration_size_gaps_and_why(drive):
    incident(drive)
    lines = said(drive, "list").stdout.splitlines()
    (of_drive,) = (line for line in lines if drive.name in line)
    assert "2025-11-23 17:46:40" in of_drive
    assert " 6.0 s " in of_drive
    assert "1 (7 frames)" in of_drive
    (of_incident,) = (line for line in lines if "fault_latched" in line)
    assert "none" in of_incident
    assert of_incident.endswith("undervoltage")


def test_the_list_as_json_has_all_of_it(drive):
    incident(drive)
    (drive.path / layout.KEEP_FILE).touch()
    of_drive, of_incident = json.loads(said(drive, "list", "--json").stdout)["recordings"]
    assert of_drive["lost"] == {"frames": 7, "ticks": 7, "gaps": 1}
    assert (of_drive["begun_wall_ns"], of_drive["channel"]) == (START_S * 10**9, "can0")
    assert (of_drive["kept"], of_drive["is_written"]) == (True, False)
    assert of_incident["reasons"] == ["undervoltage"]


def test_the_list_tells_what_is_being_written(drive):
    descriptor = layout.hold(drive.path)
    assert "being written" in said(drive, "list").stdout
    os.close(descriptor)


def test_a_drive_that_cannot_be_read_does_not_hide_the_others(drive):
    broken = WrittenDrive(drive.folder, START_S + 60)
    (broken.path / layout.DRIVE_FILE).write_text("{")
    listed = said(drive, "list").stdout
    assert drive.name in listed
    assert "is no JSON" in listed


def test_a_link_among_the_drives_is_no_drive(drive, tmp_path):
    (drive.path.parent / "20201123T").symlink_to(tmp_path)
    assert "20201123T" not in said(drive, "list").stdout
    said(drive, "remove", "--yes", "20201123T", code=66)


def test_a_whole_recording_is_whole(drive):
    (line,) = said(drive, "check").stdout.splitlines()
    assert line == (
        f"{drive.name}: whole, chained, unsigned; 2 segments, {2 * FRAMES + 7} frames received = "
        f"{2 * FRAMES} recorded + 7 in 1 gap"
    )


def test_what_is_cut_off_before_the_end_ends_with_65(drive):
    torn(drive.path / layout.frames_name(1))
    done = said(drive, "check", drive.name, code=65)
    assert "CHANGED OR DAMAGED" in done.stdout
    assert "20 missing" in done.stdout
    assert f"  {layout.frames_name(1)}: " in done.stdout


def test_the_check_as_json_has_every_fault(drive):
    torn(drive.path / layout.frames_name(1))
    found = json.loads(said(drive, "check", "--json", code=65).stdout)
    assert found["whole"] is False
    (one,) = found["recordings"]
    assert (one["missing_frames"], one["frames"]) == (20, 2 * FRAMES - 20)
    assert one["state"] == "changed"
    assert [fault["kind"] for fault in one["faults"]] == ["changed"]


def test_what_is_missing_at_the_end_ends_with_3(drive):
    drive.segment(ended=False)
    assert "INCOMPLETE" in said(drive, "check", drive.name, code=3).stdout


def test_what_is_kept_stays_until_somebody_removes_it(drive):
    assert "stays" in said(drive, "keep", drive.name).stdout
    assert (drive.path / layout.KEEP_FILE).exists()
    assert "already" in said(drive, "keep", drive.name).stdout


def test_a_part_of_a_drive_becomes_an_incident_that_stays(drive):
    drive.segment()
    words = ("keep", drive.name, "--from", "3.5", "--to", "17:46:45", "--reason", "it swerved")
    name = said(drive, *words).stdout.strip()
    path = drive.folder / layout.INCIDENTS / name
    described = layout.read_description(path / layout.INCIDENT_FILE)
    assert (described["what"], described["drive"]) == ("it swerved", drive.name)
    assert [segment.number for segment in layout.segments(path)] == [2]
    kept = layout.segments(path)[0].frames
    assert kept is not None
    assert kept.samefile(drive.path / kept.name)
    assert {one.name for one in path.iterdir()} >= {layout.KEEP_FILE, layout.CONFIG_FILE}
    assert "it swerved" in said(drive, "list").stdout
    again = said(drive, *words).stdout.strip()
    assert again == f"{name}-2"


def test_a_time_of_which_there_is_nothing_is_refused(drive):
    done = said(drive, "keep", drive.name, "--from", "3600", code=65)
    assert "has nothing of that time" in done.stderr
    said(drive, "keep", drive.name, "--to", "noon", code=2)


def test_a_part_that_ends_before_it_begins_is_refused(drive):
    done = said(drive, "keep", drive.name, "--from", "5", "--to", "2", code=2)
    assert "--from 5 is after --to 2" in done.stderr
    assert not layout.recorded_folders(drive.folder / layout.INCIDENTS)


def test_a_drive_kept_with_a_reason_is_an_incident_of_its_own_time(drive):
    name = said(drive, "keep", drive.name, "--reason", "smelled").stdout.strip()
    path = drive.folder / layout.INCIDENTS / name
    described = layout.read_description(path / layout.INCIDENT_FILE)
    assert name[:11] == drive.name[:11]
    assert described["at"][:4] == name[:4]
    assert 0 <= described["after_s"] < 600
    assert described["segments"] == [1, len(layout.segments(path))]
    text = (path / layout.CONFIG_FILE).read_bytes()
    assert described["files"][layout.CONFIG_FILE] == hashlib.sha256(text).hexdigest()
    digest = described.pop("digest")
    text = json.dumps(described, sort_keys=True, separators=(",", ":")).encode()
    assert digest == hashlib.sha256(text).hexdigest()


def test_now_is_no_part(drive):
    said(drive, "keep", "now", "--from", "3.5", code=2)


def test_a_name_that_is_none_is_answered_with_the_nearest(drive):
    done = said(drive, "keep", drive.name[:-1], code=66)
    assert f'did you mean "{drive.name}"?' in done.stderr


def test_a_removed_drive_is_gone_and_its_incident_is_not(drive):
    kept = incident(drive)
    said(drive, "remove", "--yes", drive.name)
    assert not drive.path.exists()
    assert "whole" in said(drive, "check", kept.name).stdout


def test_what_is_being_written_is_not_removed(drive):
    descriptor = layout.hold(drive.path)
    done = said(drive, "remove", "--yes", drive.name, code=75)
    os.close(descriptor)
    assert "is being written by the recorder" in done.stderr
    assert len(layout.segments(drive.path)) == 2


def test_nothing_outside_is_removed_through_a_link(drive, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside")
    (outside / "precious").write_text("kept")
    segment = layout.segments(drive.path)[0].frames
    assert segment is not None
    segment.unlink()
    segment.symlink_to(outside / "precious")
    (drive.path / "folder").symlink_to(outside)
    done = said(drive, "remove", "--yes", drive.name)
    assert "stays: folder in it is no recording" in done.stderr
    assert (outside / "precious").read_text() == "kept"
    assert [path.name for path in drive.path.iterdir()] == ["folder"]


@pytest.mark.parametrize("name", ["..", "../drives", "/etc", "."])
def test_a_path_is_no_name(drive, name):
    said(drive, "remove", "--yes", name, code=66)
    assert drive.path.exists()


def test_nobody_is_asked_where_nobody_is(drive):
    done = said(drive, "remove", drive.name, code=2)
    assert "say --yes" in done.stderr
    assert drive.path.exists()


@pytest.mark.parametrize(("answer", "gone"), [("y\n", True), ("n\n", False)])
def test_a_person_is_asked_and_the_answer_counts(drive, answer, gone):
    terminal, own = pty.openpty()
    command = [*PROGRAM, "remove", drive.name, "--folder", str(drive.folder)]
    with subprocess.Popen(command, stdin=own, stdout=subprocess.PIPE, text=True) as process:
        os.write(terminal, answer.encode())
        shown, _ = process.communicate(timeout=60)
    os.close(terminal)
    os.close(own)
    assert drive.name in shown
    assert drive.path.exists() is not gone


def test_keep_now_without_a_recorder_says_what_to_do(drive):
    done = said(drive, "keep", "now", "--status", str(drive.folder / "none.json"), code=69)
    assert "no recorder has written its state" in done.stderr
    assert "systemctl start vcu-gateway-recorder.socket" in done.stderr


@pytest.fixture
def public() -> Iterator[WrittenDrive]:
    """In a folder that everybody may enter: pytest's own are for one user."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        one = WrittenDrive(folder / "recordings")
        one.segment()
        yield one


@pytest.mark.skipif(os.geteuid() != 0, reason="another user's rights need root")
def test_without_the_right_to_read_it_says_which_group_to_join(public):
    public.folder.chmod(0o750)
    done = said(public, "list", code=77, program=[sys.executable, "-c", AS_NOBODY])
    assert "may not be read by this user" in done.stderr
    assert "usermod -aG vcu-gateway-recorder" in done.stderr


@pytest.mark.skipif(os.geteuid() != 0, reason="gives files away")
def test_what_root_keeps_belongs_to_the_recorder(public):
    for path in [public.folder, *public.folder.rglob("*")]:
        os.chown(path, 65534, 65534)
    said(public, "keep", public.name)
    kept = (public.path / layout.KEEP_FILE).stat()
    assert (kept.st_uid, kept.st_gid) == (65534, 65534)


@pytest.mark.skipif(os.geteuid() != 0, reason="gives files away")
def test_a_link_in_the_folder_leads_root_nowhere(public):
    secret = public.folder.parent / "secret"
    secret.write_text("root's own")
    secret.chmod(0o600)
    for path in [public.folder, *public.folder.rglob("*")]:
        os.chown(path, 65534, 65534)
    (public.path / layout.CONFIG_FILE).unlink()
    (public.path / layout.CONFIG_FILE).symlink_to(secret)
    done = said(public, "keep", public.name, "--reason", "mine", code=77)
    assert "root's own" not in done.stdout + done.stderr
    assert not (public.folder / layout.INCIDENTS).exists()
