"""SECURITY.md and the forms of .github: what they ask for exists, and the forms are forms."""

import re
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.docs.pages import OPERATIONS, ROOT, SECURITY, codes, command_lines, text

GITHUB = ROOT / ".github"
TEMPLATES = GITHUB / "ISSUE_TEMPLATE"
FORMS = sorted(set(TEMPLATES.glob("*.yml")) - {TEMPLATES / "config.yml"})
# What GitHub's forms know.
KINDS = {"markdown", "input", "textarea", "dropdown", "checkboxes"}
OF_A_FIELD = {"type", "id", "attributes", "validations"}


def form(path: Path) -> dict[str, Any]:
    return yaml.safe_load(text(path))


def fields(path: Path) -> list[dict[str, Any]]:
    return [one for one in form(path)["body"] if one["type"] != "markdown"]


def test_the_address_to_write_to_is_that_of_the_package():
    control = text(ROOT / "packaging" / "debian" / "control")
    (address,) = re.findall(r"^Maintainer: .* <(.*)>$", control, re.MULTILINE)
    assert f"`{address}`" in text(SECURITY)
    assert f"<{address}>" in text(ROOT / "packaging" / "assemble")


def test_after_a_movement_one_saves_at_least_what_a_bug_report_needs():
    wanted = {line for line in command_lines(OPERATIONS) if "--json" in line}
    assert len(wanted) == 5
    assert wanted <= set(command_lines(SECURITY))


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_a_form_has_fields_with_names_of_their_own(path):
    assert {"name", "description", "title", "labels", "body"} == set(form(path))
    assert {one["type"] for one in form(path)["body"]} <= KINDS
    ids = [one["id"] for one in fields(path)]
    assert len(set(ids)) == len(ids) >= 3
    for one in fields(path):
        assert set(one) <= OF_A_FIELD
        assert one["attributes"]["label"]


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_a_command_in_a_form_is_one_that_the_pages_have(path):
    known = {*command_lines(OPERATIONS), *command_lines(SECURITY), "vcu-gateway demo"}
    known |= {"vcu-gateway simulate", "vcu-gateway estop"}
    described = [one["attributes"].get("description", "") for one in fields(path)]
    named = {code for said in described for code in codes(said) if code.startswith("vcu-gateway")}
    assert named <= known


def test_nobody_opens_an_issue_without_a_form():
    assert form(TEMPLATES / "config.yml") == {"blank_issues_enabled": False}
    assert {path.stem for path in FORMS} == {
        "bug_report",
        "feature_request",
        "unexpected_movement",
    }


def test_the_pull_request_asks_for_steps_that_the_makefile_has():
    targets = set(re.findall(r"^([a-z-]+):", text(ROOT / "Makefile"), re.MULTILINE))
    named = {
        code.removeprefix("make ")
        for code in codes(text(GITHUB / "pull_request_template.md"))
        if code.startswith("make ")
    }
    assert named
    assert named <= targets
