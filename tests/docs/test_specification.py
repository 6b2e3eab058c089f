"""docs/safety.md and docs/protocol.md are the specification; the repository needs no other."""

import fnmatch
import os
import re
from collections.abc import Iterator
from pathlib import Path

from tests.docs.pages import PROTOCOL, ROOT, SAFETY, headings, rows, section, text
from vcu_gateway import config as configuration
from vcu_gateway.core.causes import Effect
from vcu_gateway.core.supervisor import Mode

SECTIONS = {page.name: headings(page) for page in (SAFETY, PROTOCOL)}
ERRATA = re.findall(r"\*\*(E\d+) ", text(PROTOCOL))
# A number with its name: `name` (20, *default*; 0 to 50).
LIMIT = re.compile(r"`(\w+)`(?: \(|, )(\d+), \*default\*(?:; (\d+) to (\d+))?")


def kept(root: Path) -> Iterator[tuple[str, str]]:
    """Name and text of every file that is not ignored; git may be missing where tests run."""
    ignored = [line.rstrip("/") for line in text(ROOT / ".gitignore").splitlines()] + [".git"]

    def counts(name: str) -> bool:
        return not any(fnmatch.fnmatch(name, pattern) for pattern in ignored)

    for folder, inner, names in os.walk(root):
        inner[:] = filter(counts, inner)
        for path in (Path(folder) / name for name in filter(counts, names)):
            try:
                yield str(path.relative_to(root)), text(path)
            except (UnicodeDecodeError, OSError):
                continue  # no text, or a link to nothing


FILES = dict(kept(ROOT))


def pages_elsewhere(files: dict[str, str]) -> set[str]:
    """Pages with a name in capitals that are named in a file and are none of the files."""
    named = {one for said in files.values() for one in re.findall(r"\b[A-Z][A-Z_-]+\.md\b", said)}
    return named - {Path(name).name for name in files}


def wrong_pointers(said: str) -> list[str]:
    """What a text points to as "docs/safety.md, Modes" or "docs/protocol.md E2" in vain."""
    line = re.sub(r"\s*\n\s*(?:# )?", " ", said)
    pointed = re.findall(r"docs/((?:safety|protocol)\.md), ([A-Z].{,60})", line)
    wrong = [rest for page, rest in pointed if not begins_with(SECTIONS[page], rest)]
    numbers = re.findall(r"(?:docs/protocol\.md|[Ee]rrat(?:a|um)) ((?:E\d+(?:, )?)+)", line)
    return wrong + [one for found in numbers for one in found.split(", ") if one not in ERRATA]


def begins_with(sections: list[str], rest: str) -> bool:
    return any(re.match(rf"{re.escape(one)}(?!\w)", rest) for one in sections)


def test_the_repository_points_to_no_page_outside_itself():
    assert {"README.md", "docs/safety.md"} <= set(FILES)
    assert pages_elsewhere(FILES) == set()


def test_a_page_outside_the_repository_is_seen():
    outside = "SAFETY" + ".md"
    assert pages_elsewhere({"README.md": f"README.md, {outside}."}) == {outside}


def test_every_section_and_erratum_that_a_file_points_to_exists():
    wrong = {name: wrong_pointers(said) for name, said in FILES.items()}
    assert {name: found for name, found in wrong.items() if found} == {}


def test_a_pointer_to_a_section_or_an_erratum_that_is_not_there_is_seen():
    safety, protocol = (f"docs/{page}.md" for page in ("safety", "protocol"))
    good = f"({safety}, Safe frames), {safety},\n    # Modes. {protocol} E13; {safety}, and so on"
    assert wrong_pointers(good) == []
    assert wrong_pointers(f"{safety}, Mode.") == ["Mode."]
    assert wrong_pointers(f"{safety}, Nodes; {protocol}, Nodes") == [f"Nodes; {protocol}, Nodes"]
    assert wrong_pointers(f"{protocol} E99; erratum" + " E0") == ["E99", "E0"]


def test_the_safety_page_has_every_effect_mode_and_invariant_and_no_other():
    first = {
        heading: [row[0] for row in rows(section(SAFETY, f"## {heading}"))]
        for heading in ("Effects", "Modes", "Invariants")
    }
    assert first["Effects"] == [effect.name for effect in Effect]
    assert first["Modes"] == [mode.name for mode in Mode]
    assert first["Invariants"] == [f"I{number}" for number in range(1, 16)]


def test_a_default_and_its_range_on_the_safety_page_are_the_configurations():
    parts = configuration.Config.model_json_schema()["$defs"].values()
    keys = {name: key for part in parts for name, key in part.get("properties", {}).items()}
    told = LIMIT.findall(text(SAFETY))
    assert len(told) > 15
    for name, *numbers in told:
        default, low, high = (float(one) if one else None for one in numbers)
        assert default == keys[name]["default"], name
        assert low is None or (low, high) == (keys[name]["minimum"], keys[name]["maximum"]), name
