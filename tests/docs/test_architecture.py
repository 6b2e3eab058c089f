"""docs/architecture.md: its picture, modules and layers are those of the code."""

import itertools
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.docs.pages import ROOT, codes, rows, section, text

PAGE = ROOT / "docs" / "architecture.md"
SOURCE = ROOT / "src" / "vcu_gateway"


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    page = tmp_path / "architecture.md"
    page.write_text(text(PAGE))
    return page


def draw(*options: object) -> subprocess.CompletedProcess[str]:
    command: list[str | Path] = [
        sys.executable,
        ROOT / "scripts" / "import-graph",
        *map(str, options),
    ]
    return subprocess.run(command, capture_output=True, text=True)


def layers() -> list[list[str]]:
    """Layers of the whole program in its import contract, from the top."""
    contracts = tomllib.loads(text(ROOT / "pyproject.toml"))["tool"]["importlinter"]["contracts"]
    [whole] = [one for one in contracts if one.get("containers") == ["vcu_gateway"]]
    return [re.findall(r"\w+", layer) for layer in whole["layers"]]


def test_the_picture_of_the_imports_is_current():
    done = draw("--check")
    assert done.returncode == 0, done.stderr


def test_a_picture_that_is_not_current_is_found_and_can_be_drawn_again(copy):
    copy.write_text(text(copy).replace("--> core", "--> cli", 1))
    done = draw("--check", "--page", copy)
    assert done.returncode == 1
    assert "run scripts/import-graph" in done.stderr
    assert draw("--page", copy).returncode == 0
    assert text(copy) == text(PAGE)


def test_a_page_without_the_marks_of_the_picture_is_refused(copy):
    copy.write_text("# Architecture\n")
    assert draw("--page", copy).returncode == 1
    assert text(copy) == "# Architecture\n"


def test_every_module_on_the_page_exists():
    modules = [code for code in codes(text(PAGE)) if re.fullmatch(r"\w+/(\w+\.py)?", code)]
    assert len(modules) > 20
    for module in modules:
        assert (SOURCE / module).exists(), module


def test_the_table_of_layers_is_that_of_the_import_contract():
    table = [codes(row[1]) for row in rows(section(PAGE, "## Layers"))]
    existing = {path.stem for path in SOURCE.iterdir() if path.stem != "__main__"}
    rank = {name: number for number, layer in enumerate(layers()) for name in layer}
    assert sorted(itertools.chain(*table)) == sorted(existing & rank.keys())
    for upper, lower in itertools.pairwise(table):
        assert max(rank[name] for name in upper) < min(rank[name] for name in lower)
