"""The pages as data: tables, commands, what stands in code."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
INSTALL = ROOT / "docs" / "install.md"
OPERATIONS = ROOT / "docs" / "operations.md"
PAGES = (INSTALL, OPERATIONS)
SAFETY = ROOT / "docs" / "safety.md"
PROTOCOL = ROOT / "docs" / "protocol.md"
RECORDINGS = ROOT / "docs" / "recordings.md"
SECURITY = ROOT / "SECURITY.md"
UNIT = ROOT / "systemd" / "vcu-gateway.service"


def text(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def headings(page: Path) -> list[str]:
    """Every heading, without its level."""
    return re.findall(r"^#+ (.*)$", text(page), re.MULTILINE)


def section(page: Path, heading: str) -> str:
    """What stands below a heading, up to the next one of its level or above."""
    level, _, _ = heading.partition(" ")
    above = "|".join("#" * count for count in range(1, len(level) + 1))
    found = re.search(
        rf"^{re.escape(heading)}\n(.*?)(?=^(?:{above}) |\Z)", text(page), re.DOTALL | re.MULTILINE
    )
    assert found, f"{page.name} has no {heading}"
    return found[1]


def rows(markdown: str) -> list[list[str]]:
    """The cells of every row of every table, heads and rules left out."""
    lines = [line for line in markdown.splitlines() if line.startswith("|")]
    rules = {number for number, line in enumerate(lines) if re.fullmatch(r"[|\s:-]+", line)}
    rules |= {number - 1 for number in rules}
    kept = (line for number, line in enumerate(lines) if number not in rules)
    return [[cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]] for line in kept]


def codes(markdown: str) -> list[str]:
    """Everything in backticks, blocks left out."""
    outside = re.sub(r"```.*?```", "", markdown, flags=re.DOTALL)
    return [found.replace("\\|", "|") for found in re.findall(r"`([^`\n]+)`", outside)]


def blocks(page: Path, language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", text(page), re.DOTALL)


def command_lines(page: Path) -> Iterator[str]:
    """Lines of the program itself in blocks, without sudo and where their output goes."""
    for block in blocks(page, "sh"):
        for line in block.splitlines():
            own = line.removeprefix("sudo ")
            if own.startswith("vcu-gateway "):
                yield own.partition(" >")[0]


def mentioned(page: Path) -> Iterator[str]:
    """The same in running text, where it is whole."""
    for code in codes(text(page)):
        own = code.removeprefix("sudo ")
        if own.startswith("vcu-gateway ") and "…" not in own:
            yield own


def words(line: str) -> list[str]:
    """The arguments of a line."""
    return shlex.split(line)[1:]


def directives(unit: Path) -> dict[str, set[str]]:
    """Every value of every directive of a unit or a file of networkd's."""
    found: dict[str, set[str]] = {}
    for line in unit.read_text(encoding="utf-8").splitlines():
        if re.match(r"[A-Z]\w*=", line):
            name, _, value = line.partition("=")
            found.setdefault(name, set()).add(value)
    return found
