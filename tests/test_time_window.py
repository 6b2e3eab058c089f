"""Window of time: what people write for --from and --to."""

import pytest

from vcu_gateway.time_window import Moment, Window, moment

NS = 1_000_000_000
START_NS = 1_763_920_000 * NS + 500_000_000  # 2025-11-23T17:46:40.5 UTC


@pytest.mark.parametrize(
    ("text", "wall_ns"),
    [
        ("90", START_NS + 90 * NS),
        ("90.25 s", START_NS + 90_250_000_000),
        ("17:46:41", 1_763_920_001 * NS),
        ("17:47", 1_763_920_020 * NS),
        ("17:46:41.000000001", 1_763_920_001 * NS + 1),
        ("17:46:40", 1_763_920_000 * NS),
        ("17:46:39", 1_763_919_999 * NS + 86_400 * NS),
        ("00:00:01", 1_763_942_401 * NS),
        ("2025-11-23T17:46:41.25", 1_763_920_001 * NS + 250_000_000),
        ("2025-11-23 17:46:41Z", 1_763_920_001 * NS),
        ("2025-11-23T18:46:41+01:00", 1_763_920_001 * NS),
    ],
)
def test_a_moment_is_on_the_recordings_clock(text, wall_ns):
    assert moment(text).wall_ns(START_NS) == wall_ns


@pytest.mark.parametrize(
    "text", ["", "noon", "24:00", "12:60", "12:00:60", "-5", "mf4", "1e3", "2025-13-01", "1:2:3"]
)
def test_what_is_no_time_is_refused(text):
    with pytest.raises(ValueError, match=r"."):
        moment(text)


def test_an_open_window_holds_everything():
    assert Window().holds(-5)
    assert Window().holds(START_NS)


def test_both_ends_of_a_window_are_inside():
    window = Window(moment("1"), moment("2"))
    found = [window.holds(START_NS + milli * NS // 1000) for milli in (0, 999, 1000, 2000, 2001)]
    assert found == [False, False, True, True, False]


def test_a_window_counts_from_the_first_stamp_that_it_was_asked_about():
    window = Window(end=Moment(10, "since start"))
    assert window.bounds_ns(100) == (-(1 << 63), 110)
    assert window.bounds_ns(500)[1] == 110
