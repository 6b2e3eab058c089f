"""What every fault test says of itself: what was seen, how fast, and where it is kept."""

import functools
import hashlib
import json
import os
import platform
import re
from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.vcan.conftest import can_is_missing, fresh_stand, stand  # noqa: F401

RESULTS_FOLDER = os.environ.get("VCU_FAULT_RESULTS")
FOLDERS_WITH_A_BUS = {"vcan", "slcan", "netem"}
ROOT = Path(__file__).parents[2]

REPORT = pytest.StashKey[pytest.TestReport]()
LINES = pytest.StashKey[list[str]]()


@dataclass
class Seen:
    """Call it with what was seen, a short sentence with figures; once or more in a test."""

    number: int
    sentences: list[str] = field(default_factory=list)
    reactions_ms: list[float] = field(default_factory=list)

    def __call__(self, sentence: str, reaction_ms: float | None = None) -> None:
        self.sentences.append(sentence)
        if reaction_ms is not None:
            self.reactions_ms.append(reaction_ms)

    @property
    def reaction_ms(self) -> float | None:
        """The slowest."""
        return round(max(self.reactions_ms), 1) if self.reactions_ms else None


def number_of(test_name: str) -> int:
    """The fault's number in the catalogue: test_f07_... is 7."""
    found = re.match(r"test_f(\d\d)_", test_name)
    assert found, f"{test_name}: a fault test is named test_fNN_the_requirement"
    return int(found[1])


@pytest.fixture
def seen(request: pytest.FixtureRequest) -> Iterator[Seen]:
    """Says what was seen: seen("silent after 212 ms", reaction_ms=212)."""
    one = Seen(number_of(request.function.__name__))
    yield one
    report = request.node.stash.get(REPORT, None)
    if report is None or (report.skipped and not hasattr(report, "wasxfail")):
        return
    if report.skipped:  # a known defect: neither passed nor forgotten
        one.sentences.append(f"known defect: {report.wasxfail}")
    if RESULTS_FOLDER:
        _keep(Path(RESULTS_FOLDER), request.node, report, one)
    told = "; ".join(one.sentences)
    lines = request.config.stash.setdefault(LINES, [])
    lines.append(f"{one.number:2d} {report.outcome}: {told} [{one.reaction_ms} ms]")
    assert one.sentences or not report.passed, "the test did not say what was seen"


def _keep(folder: Path, item: pytest.Item, report: pytest.TestReport, seen: Seen) -> None:
    """Write one result as JSON, in a file of its own."""
    folder.mkdir(parents=True, exist_ok=True)
    result = {
        "number": seen.number,
        "test": item.nodeid,
        "passed": report.passed and bool(seen.sentences),
        "seen": "; ".join(seen.sentences),
        "reaction_ms": seen.reaction_ms,
        "seconds": round(report.duration, 2),
        "kernel": platform.release(),
    }
    name = f"{seen.number:02d}-{hashlib.sha256(item.nodeid.encode()).hexdigest()[:10]}.json"
    (folder / name).write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    if report.when == "call":
        item.stash[REPORT] = report
    return report


def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter, config: pytest.Config
) -> None:
    if lines := config.stash.get(LINES, []):
        terminalreporter.section("faults")
        for line in sorted(lines):
            terminalreporter.line(line)


@functools.cache
def _why_there_is_no_bus() -> str | None:
    return can_is_missing()


@pytest.fixture(autouse=True)
def a_real_bus_where_the_folder_needs_one(request: pytest.FixtureRequest) -> None:
    """In the folders with a bus: a real vcan0, or the test is skipped; never on CI."""
    folder = request.path.relative_to(Path(__file__).parent).parts[0]
    why = _why_there_is_no_bus() if folder in FOLDERS_WITH_A_BUS else None
    if why and (os.environ.get("CI") or os.environ.get("VCU_REQUIRE_CAN")):
        pytest.exit(why, returncode=1)
    if why:
        pytest.skip(why)
