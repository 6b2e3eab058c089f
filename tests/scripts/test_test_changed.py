"""scripts/test-changed: that it finds what a change reaches, runs it, and knows all there is."""

import ast
import functools
import importlib.machinery
import importlib.util
import itertools
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

REPOSITORY = Path(__file__).parents[2]
SCRIPT = REPOSITORY / "scripts" / "test-changed"
OWN = "tests/scripts/test_test_changed.py"
MAKEFILE = """
%:
\t@echo made $@ $(IN_A_BROWSER) >> made
"""


def load() -> ModuleType:
    loader = importlib.machinery.SourceFileLoader("test_changed", str(SCRIPT))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(loader.name, loader))
    loader.exec_module(module)
    return module


changed = load()
IMPORTS = changed.Imports(REPOSITORY, [])


@functools.cache
def reached(*paths: str):
    return changed.Reached(list(paths), IMPORTS)


def tracked() -> list[str]:
    listed = subprocess.run(["git", "ls-files"], cwd=REPOSITORY, capture_output=True, text=True)
    return [path for path in listed.stdout.split("\n") if (REPOSITORY / path).is_file()]


# What the tables say of this project.


def test_every_place_that_the_map_names_exists():
    rows = [*changed.PROGRAMS.values(), *changed.FILES.values(), changed.OF_ANY_SOURCE]
    words = {word for row in rows if row != changed.ALL for word in row.split()}
    places = {word for word in words if word.startswith("tests/")} | set(changed.GUESTS)
    assert not [place for place in places if not reached_below(place)]
    assert words - places <= IMPORTS.known
    assert not [start for start in changed.FILES if not (REPOSITORY / start).exists()]


def reached_below(place: str) -> list[str]:
    return [test for test in IMPORTS.tests if f"{test}/".startswith(f"{place}/")]


def test_every_step_that_the_map_names_is_in_the_makefile():
    targets = re.findall(r"^([a-z-]+):", (REPOSITORY / "Makefile").read_text(), re.MULTILINE)
    assert {*changed.GUESTS.values(), "test"} <= set(targets)


def test_every_verb_is_in_the_map_or_runs_all():
    from vcu_gateway import cli

    modules = {cli.MODULES.get(verb, verb) for verb in cli._VERBS}
    assert modules == {*changed.PROGRAMS, "run"}


@pytest.mark.ci
def test_every_package_runs_tests_of_its_own_or_all():
    for package in sorted((REPOSITORY / "src" / "vcu_gateway").iterdir()):
        if not (package / "__init__.py").is_file():
            continue
        for path in package.rglob("*.py"):
            found = reached(str(path.relative_to(REPOSITORY)))
            of_any = set(changed.OF_ANY_SOURCE.split())
            assert found.why_all or found.tests - of_any, path


def test_a_test_that_changed_is_run_or_its_step_is():
    for test in sorted(IMPORTS.tests):
        found = reached(test)
        assert found.tests == {test} or found.why_all or found.steps == {changed.step_of(test)}


@pytest.mark.ci
def test_every_test_is_reached_by_a_module_or_a_file_outside_the_tests():
    missed = set(IMPORTS.tests)
    for path in (path for path in tracked() if not path.startswith("tests/")):
        found = reached(path)
        if found.why_all:
            continue  # has to be reached by less
        missed -= found.tests | found.left.keys()
        missed -= {test for test in missed if changed.step_of(test) in found.steps}
    of_all = {path for path in IMPORTS.tests if imports_what_runs_all(path)}
    assert missed <= of_all


def imports_what_runs_all(path: str) -> bool:
    """Whether a change that runs everything is the only one that could turn it red."""
    module = changed.module_of(path)
    return any(
        module in IMPORTS.reaching(name) for name in ("vcu_gateway.errors", "tests.conftest")
    )


def test_every_file_of_the_project_is_known_or_runs_all():
    for path in tracked():
        found = reached(path)
        known = found.tests or found.steps or found.left or found.why_all
        assert known, path


def started() -> Iterator[tuple[str, str]]:
    """Test modules with the verbs whose command lines they hold."""
    for module, path in IMPORTS.paths.items():
        if not path.startswith("tests/"):
            continue
        for node in ast.walk(ast.parse((REPOSITORY / path).read_text())):
            if isinstance(node, ast.List | ast.Tuple):
                words = [getattr(word, "value", None) for word in node.elts]
                for program, verb in itertools.pairwise(words):
                    if program == "vcu_gateway" and isinstance(verb, str) and verb != "run":
                        yield module, verb


@pytest.mark.ci
def test_every_test_that_starts_a_verb_is_reached_by_it():
    pairs = list(started())
    assert len(pairs) > 10
    for module, verb in pairs:
        if verb.replace("-", "_") not in changed.PROGRAMS:
            continue  # no such verb, on purpose
        found = reached(f"src/vcu_gateway/cli/{verb.replace('-', '_')}.py")
        starting = {IMPORTS.paths[name] for name in IMPORTS.reaching(module)} & IMPORTS.tests
        beside = Path(IMPORTS.paths[module]).parent
        here = {test for test in starting if Path(test).parent == beside}
        here -= {test for test in here if changed.step_of(test)}
        assert found.why_all or here <= found.tests, (module, verb)


def test_a_test_that_names_a_page_is_reached_by_it():
    for page in ("README.md", "docs/api.md", "docs/simulator.md", "docs/protocol.md"):
        name = page.rpartition("/")[2]
        named = {test for test in IMPORTS.tests if names_page(test, page, name)}
        found = reached(page)
        assert {test for test in named if not changed.step_of(test)} <= found.tests, page


def names_page(test: str, page: str, name: str) -> bool:
    text = (REPOSITORY / test).read_text() if test != OWN else ""
    return f'"{page}"' in text or (page == "docs/api.md" and f'"{name}"' in text)


def test_tests_of_durations_are_marked_where_they_stand():
    """Else they would run in no process: their files are found by the mark's name."""
    paths = [path for path in IMPORTS.paths.values() if path.startswith("tests/")]
    marking = {path for path in paths if "mark.clock" in (REPOSITORY / path).read_text()}
    assert marking <= IMPORTS.tests


@pytest.mark.parametrize("package", ["core", "config", "protocol", "bus", "daemon", "server"])
def test_what_every_running_gateway_imports_runs_all(package):
    for path in (REPOSITORY / "src" / "vcu_gateway" / package).glob("*.py"):
        assert reached(str(path.relative_to(REPOSITORY))).why_all


@pytest.mark.parametrize("path", ["Makefile", "pyproject.toml", "tests/conftest.py", "new/thing"])
def test_what_the_map_does_not_know_runs_all(path):
    assert reached(path).why_all


@pytest.mark.parametrize(
    ("path", "tests", "most"),
    [
        ("export/report", "tests/export/test_lines.py tests/cli/test_cli.py", 30),
        ("doctor/checks", "tests/doctor/test_verb.py tests/docs/test_install.py", 25),
        ("watch/layout", "tests/watch/test_layout.py tests/watch/test_demo.py", 20),
        ("web/guard", "tests/web/test_server.py tests/web/test_demo.py", 20),
        ("exporter/program", "tests/exporter/test_verb.py tests/monitoring/test_alerts.py", 20),
        ("replay/equality", "tests/replay/test_equality.py tests/golden/test_golden.py", 20),
    ],
)
def test_a_module_of_a_client_reaches_its_own_tests_and_few_others(path, tests, most):
    found = reached(f"src/vcu_gateway/{path}.py")
    assert not found.why_all
    assert set(tests.split()) <= found.tests
    assert len(found.tests) <= most
    assert not found.steps


def test_the_recorder_reaches_its_guest_and_the_web_leaves_its_browser():
    assert reached("src/vcu_gateway/recorder/ring.py").steps == {"test-recorded"}
    web = reached("src/vcu_gateway/web/guard.py")
    assert "test-web" in web.left.values()
    assert "test-web" in reached("src/vcu_gateway/web/page/main.js").steps


def test_a_script_of_the_page_runs_the_tests_of_its_subject_and_leaves_the_others():
    found = reached("src/vcu_gateway/web/page/stop.js")
    assert found.browsed == {"tests/web/test_stop.py"}
    assert {"tests/web/test_live.py", "tests/web/test_page.py"} <= found.left.keys()
    assert reached("src/vcu_gateway/web/page/view-now.js").browsed == {"tests/web/test_page.py"}


def test_what_lies_in_a_guests_folder_runs_its_step():
    assert reached("tests/vcan/conftest.py").steps == {"test-vcan"}
    assert reached("tests/vcan/recorder.py").steps == {"test-vcan"}
    assert reached("tests/service/unit.py").steps == {"test-service"}


def test_a_test_that_is_no_more_reaches_nothing():
    found = reached("tests/cli/test_gone.py")
    assert [found.tests, found.steps, found.left, found.why_all] == [set(), set(), {}, []]


# What it finds and runs, in a small project.


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Committed: a package with a verb that imports it late, three tests, and a Makefile."""
    files = {
        "Makefile": MAKEFILE,
        ".gitignore": "build\nmade\n__pycache__\n",
        "pyproject.toml": "[tool.pytest.ini_options]\n"
        "pythonpath = ['.', 'src']\nmarkers = ['slow', 'ci', 'clock']\n",
        "src/vcu_gateway/__init__.py": "",
        "src/vcu_gateway/export/__init__.py": "",
        "src/vcu_gateway/export/table.py": "WIDTH = 2\n",
        "src/vcu_gateway/cli/__init__.py": "",
        "src/vcu_gateway/cli/export.py": "def verb():\n    from vcu_gateway.export import table\n",
        "src/vcu_gateway/core/__init__.py": "",
        "tests/__init__.py": "",
        "tests/cli/test_cli.py": "def test_the_program():\n    pass\n",
        "tests/export/__init__.py": "",
        "tests/export/helper.py": "from vcu_gateway.export.table import WIDTH\n",
        "tests/export/test_table.py": "import pytest\n"
        "from tests.export.helper import WIDTH\n"
        "def test_width():\n    assert WIDTH == 2\n"
        "@pytest.mark.clock\ndef test_duration():\n    assert WIDTH\n"
        "@pytest.mark.ci\ndef test_long():\n    raise AssertionError\n",
        "tests/watch/test_keys.py": "def test_keys():\n    pass\n",
        "tests/recorded/test_live.py": "",
        "tests/web/test_stop.py": "",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    for words in ("init -q -b main", "add .", "commit -q -m all"):
        subprocess.run([*GIT, *words.split()], cwd=tmp_path, check=True)
    return tmp_path


GIT = ("git", "-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
TABLE = "src/vcu_gateway/export/table.py"


def run(folder: Path, *options: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), "-C", str(folder), "--no-lint", *options]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder)


def made(folder: Path) -> str:
    return (folder / "made").read_text() if (folder / "made").exists() else ""


def test_nothing_changed_is_said_and_right(folder):
    done = run(folder)
    assert (done.returncode, done.stdout) == (0, "nothing changed since the last commit\n")


@pytest.mark.ci
def test_what_is_not_committed_is_run_by_imports_and_by_programs(folder):
    (folder / TABLE).write_text("WIDTH = 2  # two\n")
    done = run(folder)
    assert done.returncode == 0, done.stdout
    assert f"{TABLE}\n  by imports: tests/export/test_table.py\n" in done.stdout
    assert "  by the program export: tests/cli/test_cli.py\n" in done.stdout
    assert re.search(r"durations: 1 passed", done.stdout)
    assert done.stdout.endswith("2 test files: all right\n")
    assert "test_keys" not in done.stdout
    assert not made(folder)


@pytest.mark.ci
def test_a_test_that_fails_is_shown_and_fails_it(folder):
    (folder / TABLE).write_text("WIDTH = 3\n")
    done = run(folder)
    assert done.returncode == 1
    assert "assert 3 == 2" in done.stdout
    assert re.search(r"2 test files; failed: tests\n$", done.stdout)


@pytest.mark.ci
def test_a_module_that_is_no_more_reaches_those_that_import_it(folder):
    (folder / TABLE).unlink()
    done = run(folder)
    assert done.returncode == 1
    assert "by imports: tests/export/test_table.py" in done.stdout
    assert "ModuleNotFoundError" in done.stdout


def test_a_commit_on_a_branch_counts_with_what_is_new(folder):
    subprocess.run([*GIT, "update-ref", "refs/remotes/origin/main", "HEAD"], cwd=folder, check=True)
    (folder / TABLE).write_text("WIDTH = 2  # two\n")
    subprocess.run([*GIT, "commit", "-aqm", "two"], cwd=folder, check=True)
    (folder / "tests/watch/test_new.py").write_text("")
    done = run(folder, "--list")
    assert TABLE in done.stdout
    assert "by being changed: tests/watch/test_new.py" in done.stdout
    assert TABLE not in run(folder, "--list", "--base", "HEAD").stdout


def test_what_all_runs_on_runs_make_test(folder):
    (folder / "src/vcu_gateway/core/__init__.py").write_text("A = 1\n")
    done = run(folder)
    assert done.returncode == 0
    assert "everything: every running gateway imports it" in done.stdout
    assert made(folder) == "made test\n"


def test_a_changed_test_of_a_guest_runs_its_step(folder):
    assert run(folder, "tests/recorded/test_live.py").returncode == 0
    assert made(folder) == "made test-recorded\n"


def test_a_changed_test_of_the_page_runs_its_file_alone_in_the_browser(folder):
    assert run(folder, "tests/web/test_stop.py").returncode == 0
    assert made(folder) == "made test-web tests/web/test_stop.py\n"


def test_a_list_runs_nothing(folder):
    done = run(folder, "--list", "src/vcu_gateway/core/__init__.py", TABLE)
    assert done.returncode == 0
    assert "to run: make test, because of src/vcu_gateway/core/__init__.py" in done.stdout
    assert not made(folder)


def test_a_wrong_command_line_is_answered_in_a_line(folder):
    for options, said in (
        (("--base", "nowhere"), "no such revision: nowhere"),
        (("nothing.py",), "no such file: nothing.py (a revision goes after --base)"),
    ):
        done = run(folder, *options)
        assert (done.returncode, done.stderr) == (2, f"test-changed: {said}\n")
