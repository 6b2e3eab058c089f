"""Received = recorded + gaps, and every member can be read."""

import os
from pathlib import Path

import pytest

from tests.recording.kept import FRAMES, FRAMES_A_SECOND, WrittenDrive, torn, zeroed
from tests.recording.signed import make_key, sign
from vcu_gateway.errors import MissingInputError
from vcu_gateway.recording import layout
from vcu_gateway.recording.check import CheckedRecording, RecordingState, check_recording
from vcu_gateway.recording.folder import RecordingFolder
from vcu_gateway.recording.members import Member, packed, read_members
from vcu_gateway.recording.signature import fingerprint


@pytest.fixture
def drive(tmp_path: Path) -> WrittenDrive:
    """Three whole segments."""
    one = WrittenDrive(tmp_path)
    for _ in range(3):
        one.segment()
    return one


def checked(drive: WrittenDrive) -> CheckedRecording:
    recording = RecordingFolder(drive.folder).named(drive.name)
    return check_recording(recording, lambda size: None)


def faults(drive: WrittenDrive) -> list[tuple[str, str]]:
    return [(fault.file, fault.what) for fault in checked(drive).faults]


def test_a_whole_drive_is_whole(drive):
    found = checked(drive)
    assert found.is_whole
    assert (found.segments, found.frames, found.gaps.gaps) == (3, 3 * FRAMES, 0)
    assert (found.missing_frames, found.is_cut_off, found.faults) == (0, False, [])


def test_frames_in_a_gap_are_not_missing(drive):
    drive.segment(gap_frames=7)
    found = checked(drive)
    assert found.is_whole
    assert (found.gaps.frames, found.gaps.gaps, found.missing_frames) == (7, 1, 0)


def test_frames_that_no_gap_tells_are_missing(drive):
    drive.segment(silently=7)
    found = checked(drive)
    assert not found.is_whole
    assert (found.frames, found.missing_frames) == (4 * FRAMES, 7)


def test_more_frames_than_were_handed_on_are_a_fault(drive):
    drive.segment(gap_frames=5, silently=-5)
    assert not checked(drive).is_whole
    assert "5 frames more are recorded" in faults(drive)[0][1]


def test_a_drive_whose_first_segments_are_gone_is_incomplete_and_the_rest_is_read(drive):
    for path in layout.segments(drive.path)[0].paths:
        path.unlink()
    found = checked(drive)
    assert found.state is RecordingState.INCOMPLETE
    assert [fault.what for fault in found.faults] == [
        "segments before 2 are not there: removed for room, or by somebody"
    ]
    assert found.frames == 2 * FRAMES


def test_a_drive_whose_last_segment_is_gone_is_incomplete(drive):
    goes_on(drive)
    drive.segment()
    assert checked(drive).is_whole
    for path in layout.segments(drive.path)[-1].paths:
        path.unlink()
    found = checked(drive)
    assert (found.state, found.is_cut_off) == (RecordingState.INCOMPLETE, True)
    assert "nothing comes after it" in found.faults[0].what


def goes_on(drive: WrittenDrive) -> None:
    drive.segment(closes=False)


@pytest.mark.parametrize("file", [layout.core_name, layout.frames_name])
@pytest.mark.parametrize("segment", [1, 2, 3])
def test_a_last_member_that_is_cut_off_in_order_is_missing(drive, segment, file):
    path = drive.path / file(segment)
    members = [part for part in read_members(path) if isinstance(part, Member)]
    os.truncate(path, members[-1].offset)
    found = checked(drive)
    assert not found.is_whole
    (fault,) = found.faults
    assert f"{segment:04d}" in fault.file or f"the end of segment {segment} is miss" in fault.what


@pytest.mark.parametrize("name", ["drive.json", "config.yaml", "vcu.dbc"])
def test_a_file_beside_the_members_that_was_changed_is_named(drive, name):
    path = drive.path / name
    path.write_bytes(path.read_bytes().replace(b" ", b"  ") + b"\n")
    found = checked(drive)
    assert found.state is RecordingState.CHANGED
    assert {fault.file for fault in found.faults} == {name}


def test_a_segment_that_has_another_ones_number_is_changed(drive):
    for segment in (3, 2):
        for name in (layout.core_name, layout.frames_name):
            (drive.path / name(segment)).rename(drive.path / name(segment + 5))
    assert checked(drive).state is RecordingState.CHANGED


def test_ticks_are_counted_as_frames_are(tmp_path):
    drive = WrittenDrive(tmp_path)
    drive.segment()
    drive.segment(ticks_silently=3)
    found = checked(drive)
    assert (found.state, found.missing_ticks) == (RecordingState.INCOMPLETE, 3)
    assert found.missing_frames == 0


@pytest.mark.parametrize("copy", ["sent", "echo"])
def test_a_command_that_is_not_its_echo_is_changed_although_the_chain_was_made_anew(tmp_path, copy):
    drive = WrittenDrive(tmp_path)
    drive.segment(other=copy)
    found = checked(drive)
    assert found.is_chained
    assert found.state is RecordingState.CHANGED
    assert "is no command that was sent" in found.faults[0].what


def test_an_older_recording_is_readable_and_not_chained(tmp_path):
    drive = WrittenDrive(tmp_path, chained=False)
    drive.segment()
    found = checked(drive)
    assert (found.state, found.is_chained) == (RecordingState.WHOLE, False)


def test_a_chain_that_was_made_anew_is_unsigned_and_one_that_was_signed_is_found(tmp_path):
    key = make_key(tmp_path / "key")
    drive = WrittenDrive(tmp_path)
    drive.segment()
    assert checked(drive).signatures.signers == ()
    sign(drive.path, key)
    found = checked(drive)
    assert found.is_whole, found
    assert (found.signatures.signers, found.signatures.segments) == ((fingerprint(key),), 1)
    other = WrittenDrive(tmp_path / "again")
    other.segment(other="both")
    for path in drive.path.glob("*.link*"):
        (other.path / path.name).write_bytes(path.read_bytes())
    found = checked(other)
    assert found.state is RecordingState.CHANGED
    assert "the signature is none of segment 1 as it is here" in found.faults[0].what


def test_with_allowed_signers_only_what_one_of_them_signed_is_whole(tmp_path):
    key, stranger = make_key(tmp_path / "key"), make_key(tmp_path / "stranger")
    allowed = tmp_path / "allowed"
    allowed.write_text(f"recorder {key.with_suffix('.pub').read_text()}")
    drive = WrittenDrive(tmp_path)
    drive.segment()
    recording = RecordingFolder(drive.folder).named(drive.name)
    assert check_recording(recording, lambda _: None, allowed).state is RecordingState.CHANGED
    sign(drive.path, stranger)
    assert check_recording(recording, lambda _: None).is_whole
    assert check_recording(recording, lambda _: None, allowed).state is RecordingState.CHANGED
    sign(drive.path, key)
    found = check_recording(recording, lambda _: None, allowed)
    assert found.is_whole, found
    assert found.signatures.signers == (f"{fingerprint(key)} (recorder)",)


def test_a_segment_that_is_gone_from_the_middle_is_a_fault(drive):
    for path in layout.segments(drive.path)[1].paths:
        path.unlink()
    assert not checked(drive).is_whole
    assert (layout.frames_name(3), "segments between 1 and 3 are missing") in faults(drive)


def test_a_torn_end_is_told_and_the_rest_is_read(drive):
    drive.segment(ended=False)
    torn(drive.path / layout.frames_name(4))
    found = checked(drive)
    assert (found.state, found.is_cut_off) == (RecordingState.INCOMPLETE, True)
    assert found.frames == 4 * FRAMES - FRAMES_A_SECOND
    assert any("the last member is cut off" in fault.what for fault in found.faults)
    assert any("without a closing record" in fault.what for fault in found.faults)


def test_a_torn_file_of_a_segment_that_was_ended_is_missing(drive):
    torn(drive.path / layout.frames_name(3))
    found = checked(drive)
    assert not found.is_whole
    assert found.missing_frames == 3 * FRAMES - found.frames > 0


def test_a_torn_end_that_was_no_end_is_missing(drive):
    torn(drive.path / layout.frames_name(2))
    found = checked(drive)
    assert not found.is_whole
    assert found.missing_frames == FRAMES_A_SECOND


def test_damage_in_the_middle_is_told_with_its_lines_and_the_rest_is_read(drive):
    zeroed(drive.path / layout.frames_name(2), offset=40)
    found = checked(drive)
    assert not found.is_whole
    assert found.frames == 3 * FRAMES - FRAMES_A_SECOND
    assert found.missing_frames == FRAMES_A_SECOND
    assert (layout.frames_name(2), f"{FRAMES_A_SECOND} lines are lost") in faults(drive)


def test_a_drive_whose_recorder_was_killed_says_so_and_nothing_was_changed(drive):
    drive.segment(ended=False)
    found = checked(drive)
    assert (found.state, found.is_cut_off) == (RecordingState.INCOMPLETE, True)
    (fault,) = found.faults
    assert "the recorder was killed" in fault.what


def test_frames_that_the_last_segment_counts_and_does_not_have_are_missing(drive):
    path = drive.path / layout.frames_name(3)
    path.write_bytes(b"")
    assert checked(drive).missing_frames == FRAMES


@pytest.mark.parametrize("name", [layout.frames_name(2), layout.core_name(2)])
def test_a_file_that_is_gone_is_a_fault(drive, name):
    (drive.path / name).unlink()
    assert not checked(drive).is_whole
    assert (name, "is missing") in faults(drive)


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        (b'{"f": 5,', b'{"g": 5,', "line 8 has no number of frames before it"),
        (b'{"f": 5,', b'{"f": 3,', "line 8 counts 3 frames after 4"),
        (b'{"f": 5,', b'{"f": 5 ', "line 8 is no JSON"),
        (b'{"checkpoint"', b'{"checkpaint"', "does not begin with a checkpoint"),
        (b'"wall_ns"', b'"ball_ns"', "has no usable begin or gap"),
    ],
)
def test_a_core_line_that_is_wrong_is_named(drive, before, after, told):
    path = drive.path / layout.core_name(1)
    members = [part for part in read_members(path) if isinstance(part, Member)]
    first = members[0].data.replace(before, after)
    rest = path.read_bytes()[members[0].size :]
    path.write_bytes(packed(first, 0, members[0].wall_s) + rest)
    assert not checked(drive).is_whole
    assert any(told in what for _, what in faults(drive))


def test_the_end_of_a_drive_that_is_being_written_is_not_judged(drive):
    drive.segment(ended=False)
    torn(drive.path / layout.core_name(4), 3)
    descriptor = layout.hold(drive.path)
    found = checked(drive)
    assert descriptor
    assert found.is_written
    assert found.is_whole
    assert (found.is_cut_off, found.faults) == (False, [])


def test_a_description_that_is_damaged_is_a_fault(drive):
    (drive.path / layout.DRIVE_FILE).write_text("{")
    assert "is no JSON" in faults(drive)[0][1]


def test_progress_tells_the_bytes_of_every_segment(drive):
    sizes: list[int] = []
    check_recording(RecordingFolder(drive.folder).named(drive.name), sizes.append)
    files = [path for segment in layout.segments(drive.path) for path in segment.paths]
    assert sum(sizes) == sum(path.stat().st_size for path in files)
    assert len(sizes) == 3


def test_a_folder_without_recordings_is_none(tmp_path):
    with pytest.raises(MissingInputError, match="has no recordings in it"):
        RecordingFolder(tmp_path)
