"""STOPPING ends after three ticks whose frames left, after ten in any case, and never before."""

import pytest

from vcu_gateway.core.ending import Shutdown


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
