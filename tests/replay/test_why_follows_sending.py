"""The gateway explains a tick when its frames have left, and so does its replay."""

from tests.replay.drives import CODEC, SimulatedDrive
from vcu_gateway.recording.reader import open_drive
from vcu_gateway.replay.equality import EqualityCheck


def test_the_first_frames_of_a_gateway_without_a_vehicle_change_no_later_tick(tmp_path):
    drive = SimulatedDrive(tmp_path / "drive")
    drive.demanded = None
    drive.silent.update(spec.name for spec in CODEC.protocol.messages)
    drive.open_link()
    folder = drive.run(3.0).end()
    check = EqualityCheck(CODEC)
    for record in open_drive(folder).runs():
        check.note(record)
    result = check.result()
    assert result.equal, result.first_difference
    assert (result.ticks, result.why_sentences) == (60, 2)


def test_a_sentence_that_was_left_out_is_a_difference(tmp_path):
    drive = SimulatedDrive(tmp_path / "drive")
    drive.open_link()
    folder = drive.run(3.0).end()
    records = list(open_drive(folder).runs())
    told = [i for i, one in enumerate(records) if type(one).__name__ == "WhyRecord"]
    check = EqualityCheck(CODEC)
    for record in records[: told[1]] + records[told[1] + 1 :]:
        check.note(record)
    first = check.result().first_difference
    assert first is not None
    assert (first.field, first.recorded) == ("why", "nothing")
