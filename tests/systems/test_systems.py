import re
from pathlib import Path

import pytest

from tests.systems import promises, systems
from tests.systems.terminal import PROFILE, FailedError, Terminal
from tests.watch.terminals import require_tmux


@pytest.fixture
def terminal(tmp_path: Path):
    require_tmux()
    (tmp_path / ".bash_profile").write_text(PROFILE)
    made = Terminal("test", f"cd {tmp_path} && HOME={tmp_path} exec bash --login", tmp_path)
    yield made
    made.close()


def test_every_python_that_the_classifiers_claim_has_a_system() -> None:
    assert promises.claimed_pythons() <= {one.python for one in systems.SYSTEMS.values()}


def test_a_claimed_python_that_nobody_ran_is_told() -> None:
    claimed = promises.claimed_pythons()
    assert promises.unproven(claimed) == ""
    assert promises.unproven(claimed - {"3.13"}) == "pyproject.toml claims Python 3.13: not run"
    assert len(claimed) > 2


def test_the_readmes_commands_are_targets_that_make_knows() -> None:
    words = promises.commands()
    makefile = (promises.REPOSITORY / "Makefile").read_text()
    for line in (words.demo, words.tools, words.test, words.test_quick, words.test_smoke):
        assert re.search(rf"^{re.escape(line.removeprefix('make '))}: ", makefile, re.MULTILINE)


def test_the_pages_have_commands_that_need_no_vehicle() -> None:
    assert promises.package()[0] == "make deb"
    assert any(line.endswith(" dbc --check") for line in promises.program())
    demo, programs = promises.examples()
    assert demo.endswith("demo --no-demand")
    assert all(line.startswith(".venv/bin/python docs/examples/") for line in programs)
    verbs = {line.split()[1] for line in promises.recordings()}
    assert verbs == {"demo", "recordings", "replay", "export"}
    for line in promises.recordings()[3:]:
        assert promises.DRIVE in line or "--folder black-box" in line, line


def test_what_is_typed_and_seen_is_kept_whole(terminal: Terminal) -> None:
    terminal.run("seq 300", 10)
    terminal.run("printf '%0150d\\n' 7", 10)
    text = terminal.text()
    assert " seq 300\n1\n2\n" in text
    assert f"\n{'0' * 149}7\n" in text


def test_a_command_that_fails_is_told_with_its_status(terminal: Terminal) -> None:
    terminal.run("true", 10)
    with pytest.raises(FailedError, match=r"exit status 3 of: \(exit 3\)"):
        terminal.run("(exit 3)", 10)
    terminal.run("(exit 3)", 10, ends=("0", "3"))


def test_a_command_that_does_not_end_is_told(terminal: Terminal) -> None:
    with pytest.raises(FailedError, match=r"no end of: sleep 9 \(within 1 s\)"):
        terminal.run("sleep 9", 1)


def test_a_question_is_answered(terminal: Terminal) -> None:
    terminal.run("read -p 'Continue? [Y/n] ' said; echo said $said", 10, answer="y")
    assert "\nsaid y\n" in terminal.text()


def test_a_program_that_ends_before_it_shows_what_it_should_has_failed(terminal: Terminal) -> None:
    terminal.begin("echo other")
    with pytest.raises(FailedError, match=r"it ended before \^expected was seen"):
        terminal.show("^expected", 10)
