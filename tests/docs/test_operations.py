"""docs/operations.md: every event, cause, exit code and directive, as the source has them."""

import ast
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.docs.events import Module, UnclearError, of_the_program
from tests.docs.pages import (
    OPERATIONS,
    PAGES,
    ROOT,
    UNIT,
    codes,
    directives,
    rows,
    section,
    text,
)
from vcu_gateway import cli, errors
from vcu_gateway import config as configuration
from vcu_gateway.core.causes import Causes, Effect, Event, Finding
from vcu_gateway.core.supervisor import Stimulus, Supervisor

SOURCE = ROOT / "src" / "vcu_gateway"
_OF_THE_GATEWAY, _, _OF_SAFE_STOP = section(OPERATIONS, "## Every event").partition("After a kill")
EVENTS = {row[0].strip("`"): row for row in rows(_OF_THE_GATEWAY)}
TOLD = of_the_program()


def severities(row: list[str]) -> set[str]:
    return set(row[1].split(", "))


def fields(row: list[str]) -> set[str]:
    return set(codes(row[2]))


def test_the_page_has_every_event_that_the_program_can_log_and_no_other():
    assert {told.name for told in TOLD} == set(EVENTS)


@pytest.mark.parametrize("told", TOLD, ids=lambda told: f"{told.name}-{told.where}")
def test_an_event_has_its_severity_its_fields_a_meaning_and_something_to_do(told):
    row = EVENTS[told.name]
    assert severities(row) <= told.severities
    assert severities(row) == told.severities or told.name.startswith("cause_")
    assert fields(row) == told.fields
    _, _, _, meaning, to_do = row
    assert meaning
    assert to_do


def as_page_says(events: list[Event]) -> None:
    for event in events:
        assert event.severity.name.lower() in severities(EVENTS[event.name])
        assert set(event.fields) == fields(EVENTS[event.name])


def test_the_severities_that_depend_are_as_the_core_gives_them():
    causes, supervisor = Causes(), Supervisor(0)
    began = causes.update([Finding("stale", "IMU", Effect.ALARM)], 1, 1)
    ended = causes.update([], 1, 3) + causes.update([], 1, 4)
    assert [event.name for event in began + ended] == ["cause_began", "cause_ended"]
    changed = [
        supervisor.apply(stimulus, 1, "a reason")
        for stimulus in (Stimulus.QUALIFIED, Stimulus.ARM, Stimulus.STOP)
    ]
    as_page_says([*began, *ended, *(event for events in changed for event in events)])


def test_what_a_run_logs_stands_on_the_page_with_these_very_fields(tmp_path):
    config = tmp_path / "gateway.yaml"
    config.write_text(
        "bus: {interface: virtual, channel: alone}\n"
        f"api: {{socket_path: {tmp_path / 'control.sock'}}}\n"
    )
    lines = logged(config, until={"api_open", "link_open", "cause_began", "why"})
    assert "stopped" in {line["event"] for line in lines}
    for line in lines:
        row = EVENTS[line["event"]]
        assert line["level"] in severities(row)
        assert set(line) == fields(row) | {"event", "level", "timestamp"}


def logged(config: Path, until: set[str]) -> list[dict[str, Any]]:
    """All lines of a run that is ended when these events have come."""
    command = [sys.executable, "-m", "vcu_gateway", "run", "-c", str(config)]
    missing, lines = set(until), []
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as run:
        try:
            for line in run.stderr:
                lines.append(json.loads(line))
                if missing == {lines[-1]["event"]}:
                    run.terminate()
                missing.discard(lines[-1]["event"])
        finally:
            run.kill()
    assert not missing, lines
    return lines


EVENT = "from vcu_gateway.core.causes import Event, Severity\n"


@pytest.mark.parametrize(
    "code",
    [
        'def tell(name): Event(f"link_{name}", Severity.INFO)',
        "def tell(name): Event(name, Severity.INFO)",
        'def tell(event): Event("x", Severity.INFO, event.fields)',
        'log.info("link_" + name)',
        'log.info("x", **fields)',
    ],
)
def test_an_event_whose_name_or_fields_the_source_does_not_tell_is_an_error(code):
    with pytest.raises(UnclearError):
        list(Module(EVENT + code, "here").told())


def test_an_event_that_a_helper_makes_is_found_where_the_helper_is_called():
    code = """
class Acceptor:
    def open(self):
        self._tell("place_taken", {"place": 1})

    def _tell(self, name, more):
        base = {"uid": 0}
        Event(name, Severity.ERROR, {**base, **more})
"""
    (told,) = Module(EVENT + code, "here").told()
    assert told.name == "place_taken"
    assert told.severities == {"error"}
    assert told.fields == {"uid", "place"}


def test_the_words_of_the_process_that_sends_the_safe_frames_are_on_the_page():
    tree = ast.parse((SOURCE / "daemon" / "safe_stop.py").read_text())
    prints = [
        ast.unparse(node.args[0])
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "print"
    ]
    assert len(prints) == 4
    shown = " ".join(row[0] for row in rows(_OF_SAFE_STOP))
    for said in prints:
        constant = max(re.split(r"\{[^}]*\}|f?['\"]", said), key=len).strip(" :")
        assert constant in shown, said


def test_every_cause_that_a_rule_finds_is_on_the_page_and_no_other():
    found = {
        node.args[0].value if isinstance(node.args[0], ast.Constant) else ast.unparse(node)
        for module in ("rules.py", "causes.py")
        for node in ast.walk(ast.parse((SOURCE / "core" / module).read_text()))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "Finding"
    }
    listed = rows(section(OPERATIONS, "## Every cause"))
    assert {row[0].strip("`") for row in listed} == found


# Exit codes.

EXITS = {
    row[0]: row for row in rows(section(OPERATIONS, "## Every exit code").partition("### ")[0])
}


def test_every_exit_code_of_the_program_is_on_the_page_and_no_other():
    documented = set(re.findall(r"^ {4}(\d+) ", errors.__doc__ or "", re.MULTILINE))
    raised = {str(kind.exit_code) for kind in errors.GatewayError.__subclasses__()}
    assert set(EXITS) == documented | raised | {"128 + n"}


def test_the_help_names_every_exit_code():
    codes_of_help = set(re.findall(r"\b(\d+) ", cli.group.epilog or ""))
    assert codes_of_help == set(EXITS) - {"128 + n"}


def test_the_page_says_which_exit_codes_are_started_again_as_the_unit_does():
    (prevented,) = directives(UNIT)["RestartPreventExitStatus"]
    assert {code for code, row in EXITS.items() if row[2] == "no"} == set(prevented.split())
    assert all(row[2].startswith("yes") for row in EXITS.values() if row[2] != "no")


# Directives, keys.


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_directive_that_a_page_names_has_the_value_that_the_unit_gives(page):
    given = directives(UNIT)
    elsewhere = {"CPUSchedulingPolicy=other", "PrivateUsers=", "CPUAffinity="}
    named = [code for code in codes(text(page)) if re.match(r"[A-Z]\w+=", code)]
    for code in set(named) - elsewhere:
        name, _, value = code.partition("=")
        assert name in given, code
        assert not value or value in given[name], code


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_key_of_the_configuration_that_a_page_names_exists(page):
    known = {
        f"{part}.{key}"
        for part, keys in configuration.effective(configuration.Config()).items()
        for key in keys
    }
    parts = "|".join({name.partition(".")[0] for name in known})
    named = {
        found for code in codes(text(page)) for found in re.findall(rf"^(?:{parts})\.\w+", code)
    }
    assert named
    assert named - known <= {"gateway.yaml"}
