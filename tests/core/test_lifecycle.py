"""Listening before talking, and the good frames that end STARTING."""

import pytest

from tests.core.simulated_drive import CODEC, MS, PROTOCOL, data
from vcu_gateway.core.mode_manager import ListenBeforeTalk, Qualification, Shutdown
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import Store


@pytest.mark.parametrize(
    ("after_ns", "over"), [(0, False), (1000 * MS - 1, False), (1000 * MS, True)]
)
def test_listening_is_over_after_its_time(after_ns, over):
    listening = ListenBeforeTalk(7, 1000)
    assert not listening.over
    assert listening.update(7 + after_ns) is over
    assert listening.over is over


def test_another_sender_makes_the_listening_begin_again():
    listening = ListenBeforeTalk(0, 1000)
    listening.again(999 * MS)
    assert not listening.update(1999 * MS - 1)
    assert listening.update(1999 * MS)


def test_once_over_listening_is_over_until_the_next_start():
    listening = ListenBeforeTalk(0, 1000)
    listening.update(1000 * MS)
    listening.again(1001 * MS)
    assert listening.update(1001 * MS)


class Counted:
    """A store that is fed by hand."""

    def __init__(self) -> None:
        received = PROTOCOL.received_by("VCU")
        self.store = Store(received, {message.name: 1600 * MS for message in received})
        self.now_ns = 0
        self.qualification = Qualification()

    def put(self, name: str, times: int = 1, **raws: int) -> None:
        for _ in range(times):
            self.now_ns += MS
            self.store.put(name, CODEC.by_name[name].decode(data(name, raws)), self.now_ns)

    def missing(self, *required: str, frames: int = 3) -> list[str]:
        settings = Settings(required_messages=required, qualify_frames=frames)
        return list(self.qualification.missing(self.store.snapshot(self.now_ns), settings))

    def begin(self, *required: str) -> None:
        self.qualification.begin(self.store.snapshot(self.now_ns), required)


def test_a_message_that_is_not_required_may_be_missing():
    one = Counted()
    one.put("BMS_Status")
    assert one.qualification.observe(one.store.snapshot(one.now_ns), ("BMS_Status",))
    assert not one.qualification.observe(one.store.snapshot(one.now_ns), ("PCU1_Status1",))


def test_a_message_that_never_came_is_waited_for():
    assert Counted().missing("BMS_Status") == ["waiting for BMS_Status"]


@pytest.mark.parametrize(
    ("frames", "missing"),
    [
        (1, ["waiting for BMS_Status: 1 of 3 good frames"]),
        (2, ["waiting for BMS_Status: 2 of 3 good frames"]),
        (3, []),
        (4, []),
    ],
)
def test_three_good_frames_are_enough(frames, missing):
    counted = Counted()
    counted.put("BMS_Status", frames)
    assert counted.missing("BMS_Status") == missing


def test_a_frame_with_a_signal_out_of_range_is_not_a_good_one():
    counted = Counted()
    counted.put("BMS_Status", 2)
    counted.put("BMS_Status", SOC=101)
    assert counted.missing("BMS_Status") == ["waiting for BMS_Status: 2 of 3 good frames"]
    counted.put("BMS_Status")
    assert counted.missing("BMS_Status") == []


def test_a_stale_message_is_waited_for_however_many_frames_came():
    counted = Counted()
    counted.put("BMS_Status", 5)
    counted.now_ns += 1600 * MS
    assert counted.missing("BMS_Status") == []
    counted.now_ns += 1
    assert counted.missing("BMS_Status") == ["waiting for BMS_Status"]


def test_every_required_message_counts_for_itself():
    counted = Counted()
    counted.put("PCU1_Status2", 3)
    counted.put("PCU2_Status2", 1)
    assert counted.missing("PCU1_Status2", "PCU2_Status2", "BMS_Status") == [
        "waiting for PCU2_Status2: 1 of 3 good frames",
        "waiting for BMS_Status",
    ]


def test_the_number_of_frames_is_configuration():
    counted = Counted()
    counted.put("BMS_Status", 4)
    assert counted.missing("BMS_Status", frames=5) == ["waiting for BMS_Status: 4 of 5 good frames"]


def test_frames_from_before_starting_do_not_count():
    counted = Counted()
    counted.put("BMS_Status", 10)
    counted.begin("BMS_Status", "PCU1_Status2")
    assert counted.missing("BMS_Status") == ["waiting for BMS_Status: 0 of 3 good frames"]
    counted.put("BMS_Status", 3)
    assert counted.missing("BMS_Status") == []


def test_a_message_that_never_came_before_starting_needs_all_its_good_frames():
    counted = Counted()
    counted.begin("BMS_Status")
    counted.put("BMS_Status", 2)
    assert counted.missing("BMS_Status") == ["waiting for BMS_Status: 2 of 3 good frames"]
    counted.put("BMS_Status")
    assert counted.missing("BMS_Status") == []


def ticked(unsent: list[bool], talking: bool = True) -> list[bool]:
    """Whether it is over after each tick of STOPPING; True: a frame of it was not sent."""
    ending, over = Shutdown(), []
    for failed in unsent:
        ending.note_tick(stopping=True)
        if failed:
            ending.note_unsent()
        over.append(ending.over(talking))
    return over


def test_three_ticks_that_left_are_enough():
    assert ticked([False] * 4) == [False, False, True, True]


def test_a_tick_that_did_not_leave_does_not_count():
    assert ticked([True, False, False, False]) == [False, False, False, True]
    assert ticked([False, False, True, False]) == [False, False, False, True]


def test_two_unsent_frames_are_one_tick_that_did_not_leave():
    ending = Shutdown()
    ending.note_tick(stopping=True)
    ending.note_unsent()
    ending.note_unsent()
    for _ in range(3):
        ending.note_tick(stopping=True)
    assert ending.over(talking=True)


def test_after_ten_ticks_it_is_over_whatever_left():
    assert ticked([True] * 10) == [False] * 9 + [True]


@pytest.mark.parametrize(("unsent", "gave_up"), [
    ([True] * 9, False),
    ([True] * 10, True),
    ([True] * 8 + [False] * 2, True),
    ([True] * 7 + [False] * 3, False),
    ([False] * 10, False),
])  # fmt: skip
def test_it_gives_up_where_fewer_than_three_of_ten_ticks_left(unsent, gave_up):
    ending = Shutdown()
    for failed in unsent:
        assert not ending.gave_up
        ending.note_tick(stopping=True)
        if failed:
            ending.note_unsent()
    assert ending.gave_up is gave_up


def test_while_it_may_not_talk_there_is_nothing_to_wait_for():
    assert ticked([False], talking=False) == [True]


@pytest.mark.parametrize("talking", [True, False])
def test_outside_stopping_nothing_is_over_and_nothing_counts(talking):
    ending = Shutdown()
    assert not ending.over(talking)
    for _ in range(20):
        ending.note_tick(stopping=False)
        ending.note_unsent()
        assert not ending.over(talking)
    for expected in (False, False, True):
        ending.note_tick(stopping=True)
        assert ending.over(talking=True) is expected
