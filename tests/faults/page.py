"""docs/faults.md from the catalogue and the results: python -m tests.faults.page RESULTS_FOLDER.

The tests write results where VCU_FAULT_RESULTS names a folder. Status 1 where a fault that has
a test has no passed result.
"""

import ast
import json
import re
import sys
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PAGE = ROOT / "docs" / "faults.md"
FAULTS = 93
_SHOWN = 2
_LONGEST = 280

HEAD = """<!-- Made by `make faults`; do not change it here. -->

# What may go wrong, and what was seen when it did

{automated} of {all} faults are brought about by a test, {passed} of them passed. A fault has one
test or several (`tests/faults/`, named with its number); each says what it saw, and the slowest of
its reactions is shown. Where the fault needs a bus it is a real SocketCAN one, and times are the
kernel's stamps in another process; elsewhere they are the gateway's own, or simulated. A reaction
is counted from the cause's frame on the bus to the later of both controllers' safe frames, where
nothing else is said. Run on {kernels}; the buses are in the lab
([its limits](../tests/lab/README.md)), on one slow processor: what a reaction took holds for that
machine, its bound for every one. *As a service* is what the installed package shows under a real
systemd (`tests/service/`, `make test-service`).

"""
TABLE = """| # | fault | injected how | expected | seen | reaction | test |
| --- | --- | --- | --- | --- | --- | --- |
"""


class Test(NamedTuple):
    """A test function of a fault."""

    number: int
    path: str
    name: str

    @property
    def place(self) -> str:
        return f"{self.path}::{self.name}"


class Row(NamedTuple):
    """All that is known of one fault."""

    fault: dict[str, Any]
    tests: tuple[Test, ...]
    results: tuple[dict[str, Any], ...]

    @property
    def state(self) -> str:
        """`passed`, `failed` or `not run`."""
        run = {result["test"].partition("[")[0] for result in self.results}
        if not all(result["passed"] for result in self.results):
            return "failed"
        is_run = self.tests and {test.place for test in self.tests} <= run
        return "passed" if is_run else "not run"


def catalogue() -> list[dict[str, Any]]:
    """The faults in the order of their numbers."""
    faults: list[dict[str, Any]] = tomllib.loads((HERE / "catalogue.toml").read_text())["fault"]
    return faults


def tests() -> list[Test]:
    """Every fault test in the folders, by reading, not running them."""
    return [
        Test(int(found[1]), str(path.relative_to(ROOT)), name)
        for path in sorted(HERE.glob("*/test_*.py"))
        for name in _functions(path)
        if (found := re.match(r"test_f(\d\d)_", name))
    ]


def _functions(path: Path) -> Iterator[str]:
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef):
            yield node.name


def results(folder: Path) -> list[dict[str, Any]]:
    """What the tests wrote, in the order of their names."""
    found = [json.loads(path.read_text()) for path in folder.glob("*.json")]
    return sorted(found, key=lambda one: (one["number"], one["test"]))


def rows(told: Iterable[dict[str, Any]]) -> list[Row]:
    """One for each fault; results of tests that are no more are left out."""
    known, told = tests(), list(told)
    places = {test.place for test in known}
    return [
        Row(
            fault,
            tuple(test for test in known if test.number == fault["number"]),
            tuple(
                one
                for one in told
                if one["number"] == fault["number"] and one["test"].partition("[")[0] in places
            ),
        )
        for fault in catalogue()
    ]


def page(all_rows: list[Row]) -> str:
    """The whole page."""
    releases = {one["kernel"] for row in all_rows for one in row.results}
    kernels = sorted({".".join(release.split(".")[:2]) for release in releases})
    head = HEAD.format(
        automated=sum(bool(row.tests) for row in all_rows),
        passed=sum(row.state == "passed" for row in all_rows),
        all=len(all_rows),
        kernels=" and ".join(f"Linux {kernel}" for kernel in kernels) or "no machine yet",
    )
    sections = _sections(all_rows)
    return head + "".join(map(_contents, sections)) + "".join(map(_section, sections))


def _sections(all_rows: list[Row]) -> list[list[Row]]:
    """The rows in parts; the first fault of a part has its title."""
    parts: list[list[Row]] = []
    for row in all_rows:
        if "section" in row.fault:
            parts.append([])
        parts[-1].append(row)
    return parts


def _contents(part: list[Row]) -> str:
    title, first, last = part[0].fault["section"], part[0].fault["number"], part[-1].fault["number"]
    return f"- [{title}](#{title.lower().replace(' ', '-')}): {first} to {last}\n"


def _section(part: list[Row]) -> str:
    return f"\n## {part[0].fault['section']}\n\n{TABLE}{''.join(map(_line, part))}"


def _line(row: Row) -> str:
    fault = row.fault
    expected = fault["expected"]
    if "open" in fault:
        expected += f". Not covered: {fault['open']}"
    if "service" in fault:
        expected += f". As a service: {fault['service']}"
    cells = (
        str(fault["number"]),
        fault["fault"],
        fault["injected"],
        expected,
        _seen(row),
        _reaction(row),
        "<br>".join(f"[{test.name[9:]}](../{test.path})" for test in row.tests),
    )
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |\n"


def _seen(row: Row) -> str:
    told = list(dict.fromkeys(_cut(one["seen"]) for one in row.results if one["seen"]))
    mark = [] if row.state == "passed" else [f"**{row.state}**"]
    more = [f"(and {len(told) - _SHOWN} more cases)"] if len(told) > _SHOWN + 1 else []
    return "<br>".join(mark + (told[:_SHOWN] + more if more else told))


def _cut(sentence: str) -> str:
    return sentence if len(sentence) <= _LONGEST else f"{sentence[:_LONGEST]} ..."


def _reaction(row: Row) -> str:
    found = [one["reaction_ms"] for one in row.results if one["reaction_ms"] is not None]
    return f"{max(found):g} ms" if found else ""


def main(folder: str) -> int:
    """Write the page; say what is missing."""
    all_rows = rows(results(Path(folder)))
    PAGE.write_text(page(all_rows), encoding="utf-8")
    wrong = [row for row in all_rows if row.state in ("failed", "not run")]
    for row in wrong:
        print(f"fault {row.fault['number']}: {row.state}", file=sys.stderr)
    passed = sum(row.state == "passed" for row in all_rows)
    print(f"{PAGE.relative_to(ROOT)}: {passed} of {len(all_rows)} passed")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
