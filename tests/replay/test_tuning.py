"""Curves in a replay: one point moved, where the drive was on each, and the vehicle's geometry."""

from pathlib import Path

import pytest

from tests.replay.drives import SimulatedDrive, tuned
from tests.replay.ran import replay, what_if

MOTOR = "curves.power_limit_w.by_motor_temperature_c"


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tuned(tmp_path_factory.mktemp("tuned") / "drive")


def test_a_drive_with_curves_is_replayed_to_the_byte(drive):
    ran = replay(drive)
    assert "equal: 301 of 301 ticks to the byte" in ran.out
    assert "verdict: holds" in ran.out


def test_one_point_moved_says_what_each_curve_did_before_and_after(drive):
    found = what_if(drive, f"{MOTOR}@110=3000")
    assert {one["field"] for one in found["fields"]} == {"PowerLimit"}
    (curve,) = [one for one in found["curves"] if one["key"] == MOTOR]
    assert curve["before"]["points"] == [[95, 14000], [110, 6000], [125, 0]]
    assert curve["after"]["points"] == [[95, 14000], [110, 3000], [125, 0]]
    assert (curve["before"]["lowest"], curve["after"]["lowest"]) == (6000, 3000)
    assert curve["after"]["limited_s"] >= curve["before"]["limited_s"] > 4
    assert [x for x, _ in curve["seconds_at"]] == [25, 110]
    assert sum(seconds for _, seconds in curve["seconds_at"]) == pytest.approx(14, abs=2)


def test_a_point_that_is_not_there_is_added_and_a_curve_can_be_taken_away(drive):
    added = what_if(drive, f"{MOTOR}@100=14000")
    (curve,) = [one for one in added["curves"] if one["key"] == MOTOR]
    assert [x for x, _ in curve["after"]["points"]] == [95, 100, 110, 125]
    without = what_if(drive, f"{MOTOR}=null")
    (curve,) = [one for one in without["curves"] if one["key"] == MOTOR]
    assert curve["after"] == {"points": None, "limited_s": 0, "lowest": None}


def test_the_table_and_the_page_have_the_curves(drive, tmp_path):
    page = tmp_path / "what-if.html"
    ran = replay(drive, "--set", f"{MOTOR}@110=3000", "--html", page)
    assert "power_limit_w.by_motor_temperature_c" in ran.out
    assert "6000 W -> 3000 W" in ran.out
    text = page.read_text()
    assert text.count("<svg class='curve'") == 3
    assert ">25 °C<" in text, "the first place of the drive"
    assert ">125 °C<" in text, "the last point of the curve"


@pytest.mark.parametrize(
    ("assignment", "text"),
    [
        (f"{MOTOR}@warm=3000", "'...@warm' is no point; write @x=y, such as @110=6000"),
        (f"{MOTOR}@110=90000", f"{MOTOR}[2]: y must be 0 to 60000 W, not 90000"),
        (f"{MOTOR}@110=14001", f"{MOTOR}[2]: must not rise with the temperature"),
        ("curves.power_limit_w.by_soc_pct@5=9", "must have 2 to 16 points, not 1"),
    ],
)
def test_a_point_that_cannot_be_is_refused_with_its_text(drive, assignment, text):
    ran = replay(drive, "--set", assignment)
    assert ran.code == 78
    assert text in ran.err


def test_the_geometry_is_measured_straight_on_above_10_km_h(tmp_path):
    drive = SimulatedDrive(tmp_path / "straight").begin()
    drive.throttle(60.0)
    drive.run(16.0)
    ran = replay(drive.end(), "--json")
    assert ran.values["geometry"]["motor_rpm_per_kmh"] == pytest.approx(85.3, rel=0.02)
    assert ran.values["geometry"]["samples"] >= 40


def test_a_drive_too_slow_or_too_short_measures_nothing(drive):
    assert replay(drive, "--json").values["geometry"] is None
