"""docs/README.md and the pages around it: all of them found from it, every link in order."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.pages import ROOT, codes, rows, section, text

DOCS = ROOT / "docs"
INDEX = DOCS / "README.md"
DECISIONS = DOCS / "decisions"
GLOSSARY = DOCS / "glossary.md"
AT_THE_TOP = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md")]
PAGES = [*AT_THE_TOP, *sorted(DOCS.rglob("*.md"))]
LINK = re.compile(r"\]\(([^()\s]+)\)")


def links(page: Path) -> Iterator[tuple[Path, str]]:
    """File and heading of every link of a page, those to other machines left out."""
    for target in LINK.findall(re.sub(r"```.*?```", "", text(page), flags=re.DOTALL)):
        if not re.match(r"\w+:", target):
            path, _, anchor = target.partition("#")
            yield (page.parent / path).resolve() if path else page, anchor


def linked(page: Path) -> set[Path]:
    return {path for path, _ in links(page)}


def named(page: Path) -> str:
    return str(page.relative_to(ROOT))


def anchors(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", text(page), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", one.lower()).replace(" ", "-") for one in headings}


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_every_link_of_a_page_leads_to_a_file_and_a_heading(page):
    for path, anchor in links(page):
        assert path.exists(), path
        assert not anchor or anchor in anchors(path), f"{path.name}#{anchor}"


def test_the_index_is_linked_from_the_readme():
    assert INDEX in linked(ROOT / "README.md")


def test_every_page_in_docs_stands_in_the_index_or_in_that_of_its_folder():
    for page in set(DOCS.rglob("*.md")) - {INDEX}:
        own = page.parent / "README.md"
        assert page in linked(INDEX if page in (own, DOCS / page.name) else own), named(page)


def test_the_index_says_of_every_page_what_it_answers():
    for link, answer in rows(text(INDEX)):
        assert LINK.search(link), link
        assert answer


# Decisions.

RECORDS = sorted(DECISIONS.glob("[0-9]*.md"))


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record.stem)
def test_a_record_has_its_number_its_status_and_its_three_parts(record):
    assert re.fullmatch(r"\d{4}(-[a-z0-9]+)+", record.stem)
    lines = text(record).splitlines()
    assert lines[0].startswith(f"# {int(record.stem[:4])}. ")
    assert re.fullmatch(r"Status: (accepted|superseded by \[\d+\]\(.*\))", lines[2])
    for part in ("Context", "Decision", "Consequences"):
        assert section(record, f"## {part}").strip()


def test_the_index_of_records_has_each_number_once_and_in_order():
    table = rows(text(DECISIONS / "README.md"))
    numbers = [int(row[0]) for row in table]
    assert numbers == list(range(1, len(numbers) + 1))
    assert len({record.stem[:4] for record in RECORDS}) == len(RECORDS)
    for record in RECORDS:
        _, name, sentence = table[int(record.stem[:4]) - 1]
        assert f"]({record.name})" in name
        assert sentence


# The glossary.


def test_the_glossary_has_every_term_once_in_order_and_says_where_it_stands():
    entries = re.split(r"^- (?=\*\*)", text(GLOSSARY), flags=re.MULTILINE)[1:]
    terms = [entry.removeprefix("**").partition("**")[0] for entry in entries]
    first = [term.partition(",")[0].casefold() for term in terms]
    assert first == sorted(set(first))
    for term, entry in zip(terms, entries, strict=True):
        assert re.search(r"`[\w/.]+/|\]\(|`health`", entry), term


@pytest.mark.parametrize("page", [GLOSSARY, *RECORDS], ids=named)
def test_a_module_that_a_page_names_exists(page):
    modules = {code for code in codes(text(page)) if re.fullmatch(r"(\w+/)*\w+\.py", code)}
    missing = {one for one in modules if not (ROOT / "src" / "vcu_gateway" / one).exists()}
    assert not {one for one in missing if not (ROOT / one).exists()} - {"safe_stop.py"}
