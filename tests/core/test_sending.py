"""The book of our frames: what was sent, and for how many ticks nothing came back."""

import pytest

from vcu_gateway.core.sending import SentHistory, SentValues

BOTH = ("PCU1", "PCU2")


class Ticks:
    """One tick after the other; each says which echoes had come back before it."""

    def __init__(self) -> None:
        self.sending = SentHistory(BOTH)
        self.confirmed = dict.fromkeys(BOTH, 0)

    def tick(self, *echoes: str, emits: bool = True) -> int:
        for name in echoes:
            self.confirmed[name] += 1
        missed = self.sending.note_confirmed(self.confirmed)
        self.sending.note_emitted(emits)
        return missed


def test_the_first_tick_misses_nothing():
    assert Ticks().tick() == 0


def test_every_tick_without_an_echo_is_counted_until_one_comes():
    ticks = Ticks()
    assert [ticks.tick() for _ in range(5)] == [0, 1, 2, 3, 4]
    assert ticks.tick(*BOTH) == 0
    assert ticks.tick() == 1


@pytest.mark.parametrize("name", BOTH)
def test_the_echo_of_one_controllers_frame_does_not_confirm_the_others(name):
    ticks = Ticks()
    assert [ticks.tick(name) for _ in range(4)] == [0, 1, 2, 3]


def test_several_echoes_at_once_are_as_good_as_one():
    ticks = Ticks()
    ticks.tick()
    assert ticks.tick("PCU1", "PCU1", "PCU2", "PCU2") == 0


def test_a_tick_after_one_that_sent_nothing_misses_nothing():
    ticks = Ticks()
    assert [ticks.tick(emits=False) for _ in range(5)] == [0] * 5


def test_silence_of_our_own_does_not_excuse_what_was_missed_before():
    ticks = Ticks()
    assert [ticks.tick(), ticks.tick(), ticks.tick(emits=False)] == [0, 1, 2]
    assert [ticks.tick(emits=False), ticks.tick()] == [2, 2]
    assert ticks.tick(*BOTH) == 0


def test_the_history_holds_each_controllers_throttles_oldest_first():
    sending = SentHistory(BOTH)
    sending.note_sent("PCU1", SentValues(1, 10.0))
    sending.note_sent("PCU2", SentValues(2, 20.0, reverse=True))
    sending.note_sent("PCU1", SentValues(3, 30.0))
    assert {name: list(sent) for name, sent in sending.history.items()} == {
        "PCU1": [SentValues(1, 10.0), SentValues(3, 30.0)],
        "PCU2": [SentValues(2, 20.0, reverse=True)],
    }


def test_the_history_reaches_over_the_echo_window_and_is_bounded():
    """1.1 s before a Status1 of up to 1.6 s: 54 frames of 50 ms."""
    sending = SentHistory(BOTH)
    for number in range(1000):
        sending.note_sent("PCU1", SentValues(number * 50_000_000, 1.0))
    kept = sending.history["PCU1"]
    assert kept[-1].at_ns - kept[0].at_ns >= 2_700_000_000
    assert len(kept) <= 100
