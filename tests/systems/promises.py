"""What the project promises of systems, read where it is promised: README.md, pyproject.toml."""

import re
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

REPOSITORY = Path(__file__).parents[2]

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


def claimed_pythons() -> set[str]:
    """The versions that the classifiers claim, such as 3.11."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    claims = (entry.removeprefix(_CLASSIFIER) for entry in project["classifiers"])
    return {claim for claim in claims if re.fullmatch(r"3\.\d+", claim)}


def unproven(ran: Iterable[str | None]) -> str:
    """A sentence that names the claimed versions that are not among these, or nothing."""
    missing = sorted(claimed_pythons().difference(ran))
    return f"pyproject.toml claims Python {', '.join(missing)}: not run" if missing else ""
