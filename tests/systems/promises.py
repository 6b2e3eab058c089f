"""What the project promises of systems, read where it is promised: README, docs, pyproject.toml."""

import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).parents[2]

DRIVE = "black-box/drives/*"
"""The one drive that the commands of docs/recordings.md have recorded."""

_CLASSIFIER = "Programming Language :: Python :: "


class Commands(NamedTuple):
    """What a newcomer types, as README.md has it."""

    install: str
    demo: str
    tools: str
    test: str
    test_quick: str
    test_smoke: str


def commands() -> Commands:
    """The commands of the README's section "Two commands"."""
    text = (REPOSITORY / "README.md").read_text()
    section = text.split("\n## Two commands\n")[1].split("\n## ")[0]
    [two] = re.findall(r"```sh\n(.*?)```", section, re.DOTALL)
    [install] = re.findall(r"`(sudo apt update .*?)`", section)
    demo, test = two.splitlines()
    [test_quick], [test_smoke] = (
        re.findall(rf"`({re.escape(test)}-{what})`", section) for what in ("quick", "smoke")
    )
    [tools] = set(re.findall(r"`(make tools)`", section))
    return Commands(install, demo, tools, test, test_quick, test_smoke)


def package() -> list[str]:
    """The README's commands that build and install the package, on a Debian that it is for."""
    (block,) = (block for block in _blocks("README.md", "The program") if "make deb" in block)
    return block.splitlines()


def program() -> list[str]:
    """The README's commands of the program in a clone: its first block of them."""
    return _blocks("README.md", "The program")[0].splitlines()


def recordings() -> list[str]:
    """Commands of docs/recordings.md without a vehicle: of the demo's drive, on all of it."""
    page = "docs/recordings.md"
    # What asks a running recorder is for a second terminal.
    trying = [line for line in _lines(page, "Trying it without a vehicle") if " now" not in line]
    of_a_drive = (*_lines(page, "Replay, what-if and verdict"), *_lines(page, "Exporting"))
    drive = re.compile(r"\b\d{8}T\d{6}Z-[0-9a-f]{8}\b")
    others = re.compile(r" --(from|to) \d| -c ")  # a time of the page's drive, a file of its own
    return trying + [
        drive.sub(DRIVE, line)
        for line in of_a_drive
        if drive.search(line) and not others.search(line)
    ]


def examples() -> tuple[str, list[str]]:
    """Of docs/examples/README.md: the demo that nobody drives, and the programs beside it.

    Without the one that needs a joystick.
    """
    demo, programs = _blocks("docs/examples/README.md", "Without hardware")
    return demo.strip(), [line for line in programs.splitlines() if "joystick" not in line]


def _lines(page: str, heading: str) -> list[str]:
    """Lines of the program itself in the blocks of a section."""
    lines = "".join(_blocks(page, heading)).splitlines()
    return [line for line in lines if line.startswith("vcu-gateway ")]


def _blocks(page: str, heading: str) -> list[str]:
    text = (REPOSITORY / page).read_text()
    section = text.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return re.findall(r"```sh\n(.*?)```", section, re.DOTALL)


def claimed_pythons() -> set[str]:
    """The versions that the classifiers claim, such as 3.11."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    claims = (entry.removeprefix(_CLASSIFIER) for entry in project["classifiers"])
    return {claim for claim in claims if re.fullmatch(r"3\.\d+", claim)}


def unproven(ran: Iterable[str | None]) -> str:
    """A sentence that names the claimed versions that are not among these, or nothing."""
    missing = sorted(claimed_pythons().difference(ran))
    return f"pyproject.toml claims Python {', '.join(missing)}: not run" if missing else ""
