"""The fault matrix is whole: every fault is known, and has a test."""

import json

import pytest

from tests.faults import page

CATALOGUE = page.catalogue()


def test_the_catalogue_holds_every_fault_once():
    assert [fault["number"] for fault in CATALOGUE] == list(range(1, page.FAULTS + 1))
    for fault in CATALOGUE:
        assert set(fault) <= {
            "number",
            "section",
            "fault",
            "injected",
            "expected",
            "open",
            "service",
        }
        assert all(fault[key] for key in ("fault", "injected", "expected"))


def test_every_fault_has_a_test():
    tested = {test.number for test in page.tests()}
    missing = sorted(set(range(1, page.FAULTS + 1)) - tested)
    assert not missing, f"faults without a test: {missing}"


def test_the_page_names_a_failed_fault_and_one_that_was_not_run():
    first, second = (page.Test(n, "tests/faults/pure/test_x.py", f"test_f0{n}_x") for n in (1, 2))
    good, bad = (
        {"number": 1, "test": f"{first.place}[{case}]", "passed": passed, "seen": case,
         "reaction_ms": reaction_ms, "kernel": "6.1"}
        for case, passed, reaction_ms in (("a", True, 12.5), ("b|c", False, None))
    )  # fmt: skip
    rows = [
        page.Row(CATALOGUE[0], (first,), (good, bad)),
        page.Row(CATALOGUE[1], (second,), ()),
        page.Row(CATALOGUE[2], (first,), (good,)),
        page.Row(CATALOGUE[21], (), ()),
    ]
    assert [row.state for row in rows] == ["failed", "not run", "passed", "not run"]
    lines = page.page(rows).splitlines()
    assert "**failed**<br>a<br>b\\|c | 12.5 ms |" in next(li for li in lines if "| 1 |" in li)
    assert "**not run**" in next(line for line in lines if line.startswith("| 2 |"))
    assert lines[4].startswith("3 of 4 faults are brought about by a test, 1 of them passed.")
    assert "- [Frames and messages](#frames-and-messages): 1 to 22" in lines


def test_the_contents_of_the_page_lead_to_every_part_of_it():
    lines = page.PAGE.read_text(encoding="utf-8").splitlines()
    titles = [fault["section"] for fault in CATALOGUE if "section" in fault]
    assert [line.removeprefix("## ") for line in lines if line.startswith("## ")] == titles
    led_to = [line.partition("]")[0].removeprefix("- [") for line in lines if "](#" in line]
    assert led_to == titles


def test_results_of_tests_that_are_no_more_do_not_count(tmp_path):
    gone = {"number": 1, "test": "tests/faults/pure/test_x.py::test_f01_gone", "passed": True}
    (tmp_path / "01-a.json").write_text(json.dumps(gone))
    rows = page.rows(page.results(tmp_path))
    assert rows[0].results == ()


@pytest.mark.parametrize("name", ["test_frames", "test_f1_x", "test_f123_x"])
def test_a_fault_test_bears_its_number(name):
    from tests.faults.conftest import number_of

    with pytest.raises(AssertionError):
        number_of(name)
