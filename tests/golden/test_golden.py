"""Golden drives: recordings that every change of the core is held against, to the byte."""

import re
import shutil
import tomllib
from pathlib import Path

import pytest

from tests.golden import accept, replayed
from tests.golden.broken_cores import BROKEN_CORES, BrokenCore
from tests.golden.every import DRIVES
from tests.golden.faults import CANNOT, holding
from tests.golden.mutants import ENDED
from tests.golden.recording import FOLDER, contents, record
from tests.golden.replayed import replay
from tests.golden.simulate import SCENARIOS
from vcu_gateway.core import rules

ROOT = Path(__file__).parents[2]
CATALOGUE = ROOT / "tests" / "faults" / "catalogue.toml"
MOST_BYTES = 4 << 20
MEANT = "if that is meant: make golden-accept"


@pytest.mark.parametrize("name", DRIVES)
def test_it_is_replayed_to_the_byte(name: str) -> None:
    lines = replay(DRIVES[name]).lines()
    assert lines == [], "\n".join([*lines, MEANT])


@pytest.mark.ci
@pytest.mark.parametrize("name", DRIVES)
def test_recording_it_again_gives_the_same(name: str, tmp_path: Path) -> None:
    found, kept = contents(record(DRIVES[name], tmp_path)), contents(FOLDER / name)
    assert found.keys() == kept.keys()
    for file, text in kept.items():
        assert found[file] == text, f"{name}/{file}; {MEANT}"


def test_there_is_no_recording_without_a_script() -> None:
    assert {path.name for path in FOLDER.iterdir()} == set(DRIVES)


def test_each_scenario_has_its_drive() -> None:
    held = {drive.scenario for drive in DRIVES.values()}
    assert {path.name for path in SCENARIOS.glob("*.yaml")} <= held


def numbers() -> list[int]:
    faults = tomllib.loads(CATALOGUE.read_text("utf-8"))["fault"]
    return [fault["number"] for fault in faults]


@pytest.mark.parametrize("number", numbers())
def test_each_fault_is_in_a_drive_or_has_a_reason(number: int) -> None:
    assert bool(holding(number)) != (number in CANNOT)


def test_no_drive_names_a_fault_that_is_none() -> None:
    named = {number for drive in DRIVES.values() for number in drive.faults}
    assert named | set(CANNOT) == set(numbers())


@pytest.mark.parametrize("core", BROKEN_CORES, ids=lambda core: core.blocked)
def test_the_mistake_that_shows_the_gate_can_still_be_made(core: BrokenCore) -> None:
    compile(core.source(), core.module, "exec")
    assert set(core.drives) <= set(DRIVES)


@pytest.mark.parametrize("name", ENDED)
def test_a_drive_that_ends_does_so_in_stopping(name: str) -> None:
    assert '"mode":"stopping"' in contents(FOLDER / name)["0001.core.jsonl.gz"]


def test_all_of_them_stay_small() -> None:
    files = [path for path in FOLDER.rglob("*") if path.is_file() and not path.is_symlink()]
    assert sum(path.stat().st_size for path in files) <= MOST_BYTES


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two of the drives, and a place for their report."""
    chosen = ("ended-in-order", "second-track-required")
    folder = tmp_path / "drives"
    for name in chosen:
        shutil.copytree(FOLDER / name, folder / name, symlinks=False)
    for module in (accept, replayed):
        monkeypatch.setattr(module, "FOLDER", folder)
    monkeypatch.setattr(accept, "DRIVES", {name: DRIVES[name] for name in chosen})
    monkeypatch.setattr(accept, "CHANGES", tmp_path / "CHANGES.md")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_changed_core_is_told_by_drive_tick_field_before_and_after(
    kept: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(rules, "_UNCONFIRMED_MAX_TICKS", 1)
    assert accept.check() == 1
    told = capsys.readouterr().out
    assert re.search(r"^ended-in-order: \d+ of \d+ ticks differ \(", told, re.MULTILINE)
    assert re.search(r"^  first: tick \d+, \d\.\d{3} s, ", told, re.MULTILINE)
    assert re.search(r"^    before: .*\n    after:  ", told, re.MULTILINE)
    assert "make golden-accept" in told


def test_accepting_records_anew_and_keeps_the_report(
    kept: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(rules, "_UNCONFIRMED_MAX_TICKS", 1)
    assert accept.accept() == 0
    assert accept.check() == 0
    report = (kept / "CHANGES.md").read_text()
    assert "ended-in-order: recorded anew" in report
    assert "    before: " in report
    capsys.readouterr()
    assert accept.accept() == 0
    assert "nothing to accept" in capsys.readouterr().out
