"""A recorded drive: what a healthy recorder on a healthy disk leaves."""

import gzip

from tests.recorder.gateway import account, core_lines, damage, drives, members
from vcu_gateway.drive_format import layout


def test_every_frame_is_recorded_in_order(recorder, gateway, tmp_path):
    process = recorder()
    vehicle = gateway()
    vehicle.drive(2.5)
    vehicle.begin_segment()
    vehicle.drive(1.2)
    vehicle.close()
    assert process.stop() == 0, process.errors
    (drive,) = drives(tmp_path)
    assert account(drive) == (vehicle.frames, 0)
    first, second = layout.segments(drive)
    assert [core_lines(one)[-1]["end"]["why"] for one in (first, second)] == [
        "the next segment begins",
        "the connection ended",
    ]
    assert not damage(first.frames)
    assert not damage(first.core)
    assert 2 <= len(members(first.frames)) <= 5
    text = gzip.decompress(first.frames.read_bytes()).decode().splitlines()
    assert all(line.endswith(" R") and line.split()[1] == "vcan0" for line in text)
