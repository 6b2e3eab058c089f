import pytest
from bench.figures import Figure, Options, alone, compared, compared_tails


def limited(ours: float, *, absolute: bool = False) -> Figure:
    return Figure("", "", ours, 1.0, "", 0.65, 0.5, absolute, ratio=ours)


@pytest.mark.parametrize(
    ("ratio", "verdict"),
    [(0.5, "stretch"), (0.501, "target"), (0.65, "target"), (0.651, "MISSED")],
)
def test_a_ratio_up_to_its_target_is_reached(ratio, verdict):
    assert limited(ratio).verdict == verdict
    assert limited(ratio, absolute=True).verdict == verdict


def test_without_a_target_nothing_is_judged():
    assert compared("", "", [9], [1], "").verdict == ""


def test_a_target_for_the_ratio_is_not_reached_by_a_small_figure_of_ours():
    assert compared("", "", [0.1], [0.1], "", target=0.65).verdict == "MISSED"


def test_the_ratio_is_the_median_of_the_ratios_within_each_turn():
    figure = compared("", "", [1, 10, 100], [1, 20, 25], "")
    assert figure.ratio == 1
    assert figure.spread == (0.75, 2.5)


def test_ours_and_the_peer_are_shown_by_their_medians():
    figure = compared("", "", [1, 5, 2], [30, 10, 20], "")
    assert (figure.ours, figure.peer) == (2, 20)


def test_turns_of_different_number_are_refused():
    with pytest.raises(ValueError, match="shorter"):
        compared("", "", [1, 2], [1], "")


def test_a_peer_of_nothing_gives_no_ratio():
    figure = compared("", "", [1.0], [0.0], "")
    assert figure.ratio is None
    assert figure.cells()[3:5] == ["", ""]


def test_a_percentile_is_that_of_all_turns_together():
    ours, peer = [[1.0] * 99 + [50.0], [1.0] * 100], [[2.0] * 100, [2.0] * 100]
    figure = compared_tails("", "", 0.99, ours, peer, "")
    assert (figure.ours, figure.peer, figure.ratio) == (1, 2, 0.5)
    assert figure.spread == (6.625, 18.875)


def test_a_figure_without_a_peer_shows_the_spread_of_its_own_values():
    figure = alone("start", "ms", [300, 100, 200], target=250)
    assert figure.cells() == ["start", "200 ms", "", "", "150 … 250", "250", "", "target"]


def test_a_line_of_the_table_shows_peer_ratio_spread_and_limits():
    figure = compared("whole program", "%", [1.2, 1.6], [2, 2], "naive", 0.65, 0.5)
    assert figure.cells() == [
        "whole program", "1.4 %", "2 % (naive)", "0.70", "0.65 … 0.75", "0.65", "0.50", "MISSED",
    ]  # fmt: skip


def test_a_quick_look_still_runs_programs_in_three_turns():
    assert Options(0.15).turns(7) == 3
    assert Options(1.0).turns(7) == 7
