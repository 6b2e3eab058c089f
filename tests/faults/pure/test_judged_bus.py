"""A recorded bus before the judge: what is wrong on it is found."""

from typing import NamedTuple

import pytest

from tests.faults.judged_bus import COMMANDS, EXTENDED, MS, STATUS2, check

ZERO = bytes.fromhex("0c000000e02e0000")
START_NS = 1_700_000_000_000_000_000


class Frame(NamedTuple):
    stamp_ns: int
    flags: int
    can_id: int
    data: bytes


def drive(throttles, first=0x04, power=30_000):
    """Frames of both controllers every 50 ms, ACTIVE where the throttle is not None."""
    frames = []
    for index, throttle in enumerate(throttles):
        data = ZERO
        if throttle is not None:
            data = bytes((first, throttle, 0, 0, 0xE0, 0x2E, power & 255, power >> 8))
        at_ns = START_NS + index * 50 * MS
        for offset, status in enumerate(STATUS2):
            frames.append(Frame(at_ns - 5 * MS + offset, EXTENDED, status, bytes(8)))
        for offset, can_id in enumerate(COMMANDS):
            frames.append(Frame(at_ns + offset * MS, EXTENDED, can_id, data))
    return frames


def log(*changes):
    return [
        {"event": "mode_changed", "after": mode, "timestamp": f"2023-11-14T22:13:{at_s:09.6f}Z"}
        for at_s, mode in changes
    ]


def test_a_drive_as_it_should_be_passes_and_is_counted():
    frames = drive([None, 0, 12, 24, 0, None])
    checked = check(frames, log=log((20.053, "active"), (20.253, "standby")))
    assert checked == (12, 4, 50.0, 50.0, 0)
    assert str(checked) == "12 command frames 50.0 to 50.0 ms apart"


def test_frames_that_are_missing_are_counted():
    frames = drive([None] * 6)
    del frames[8:16]
    assert check(frames).missing == 2


def replaced(index, **changes):
    frames = drive([None, 0, 12, 24])
    commands = [at for at, frame in enumerate(frames) if frame.can_id in COMMANDS]
    at = commands[index]
    frames[at] = frames[at]._replace(**changes)
    return frames


@pytest.mark.parametrize(
    ("frames", "found"),
    [
        (drive([None, 0, 14]), "I3"),
        (drive([None, 0, 12], power=60_001), "I1 PowerLimit"),
        (replaced(2, stamp_ns=START_NS + 24 * MS), "I4"),
        (replaced(2, data=ZERO[:7]), "eight bytes"),
        (replaced(2, data=bytes.fromhex("0c000000e12e0000")), "gate SpeedLimit"),
        (replaced(2, data=bytes.fromhex("0d000000e02e0000")), "unused bits"),
        (replaced(2, data=bytes.fromhex("0c000001e02e0000")), "unused bits"),
        (replaced(2, data=bytes.fromhex("04410f00e02e0000")), "I11"),
        (replaced(6, data=bytes.fromhex("14180000e02e0000")), "I12"),
    ],
)
def test_each_violation_is_found(frames, found):
    with pytest.raises(AssertionError, match=found):
        check(frames)


def test_a_direction_that_changes_at_speed_is_found():
    frames = drive([None, None, None])
    turned = [f._replace(data=bytes([0x1C]) + f.data[1:]) for f in frames if f.can_id in COMMANDS]
    slow = [*frames[:2], *turned[:0], *frames[2:4], *frames[4:6], *turned[2:4]]
    check(slow)
    fast = [
        frame._replace(data=bytes((0, 0, 0, 0, 0, 0, 50, 0))) if frame.can_id in STATUS2 else frame
        for frame in slow
    ]
    with pytest.raises(AssertionError, match="I12"):
        check(fast)
    with pytest.raises(AssertionError, match="I12"):
        check([frame for frame in slow if frame.can_id in COMMANDS])


@pytest.mark.parametrize(
    "changes", [(), ((20.4, "active"),), ((19.0, "active"), (20.02, "standby"))]
)
def test_torque_outside_active_is_found(changes):
    with pytest.raises(AssertionError, match="I2"):
        check(drive([None, 0, 12]), log=log(*changes))


def test_frames_of_another_sender_are_left_out():
    frames = drive([None, None])
    rogue = Frame(START_NS + 2 * MS, EXTENDED, COMMANDS[0], bytes([0, 231, *ZERO[2:]]))
    check([*frames[:4], rogue, *frames[4:]], foreign=lambda frame: frame.data[1] == 231)
    with pytest.raises(AssertionError):
        check([*frames[:4], rogue, *frames[4:]])
