"""Answers of another shape: each costs what it concerns alone, and is named."""

import json
from collections.abc import Iterator
from typing import Any

import pytest

from tests.web.other_shapes import variants
from vcu_gateway import __version__
from vcu_gateway.api import results
from vcu_gateway.client import Client
from vcu_gateway.web.gateway_link import AnswerSections
from vcu_gateway.web.state_row import misfits
from vcu_gateway.web.stream import Broadcast
from vcu_gateway.web.users import WebEvents

NAMES = ("state", "why", "health", "events", "protocol")
FEW_MESSAGES = ("BMS_Status", "PCU1_Status1")


@pytest.fixture(scope="module")
def real(gateway) -> dict[str, Any]:
    """What a gateway that has stopped answers, with few signals: of each kind there is one."""
    with Client(gateway.socket_path) as client:
        client.estop()
        gateway.ask("cuts")
        answers: dict[str, Any] = {
            "state": client.state(FEW_MESSAGES),
            "why": client.why(),
            "health": client.health(),
            "events": client.events(5),
            "protocol": client.protocol(),
        }
    for message in answers["state"]["messages"].values():
        message["signals"] = dict(list(message["signals"].items())[:2])
    for message in answers["protocol"]["messages"]:
        message["signals"] = message["signals"][:2]
    return json.loads(json.dumps(answers))


class Page:
    """The answers as they go to the browsers."""

    def __init__(self) -> None:
        self.lines: list[dict[str, Any]] = []
        self._broadcast = Broadcast()
        self._seen = {}
        events = WebEvents(lambda line: self.lines.append(json.loads(line)))
        self.now_ms = 0.0
        self.answers = AnswerSections(self._broadcast, events, lambda: self.now_ms)
        events.on_change = self.answers.note_event

    def take(self, name: str, answer: Any) -> None:
        self.now_ms += 1001
        getattr(self.answers, f"take_{name}")(answer)

    def sections(self) -> dict[str, Any]:
        """What is new for a browser."""
        self.answers.send_events()
        text = self._broadcast.unseen(self._seen).decode()
        parts = [one.split("\n")[:2] for one in text.split("\n\n") if one]
        return {name[7:]: json.loads(data[6:]) for name, data in parts}


def all_taken(page: Page, answers: dict[str, Any]) -> dict[str, Any]:
    for name in ("protocol", "state", "why", "health", "events"):
        page.take(name, answers[name])
    return page.sections()


def test_a_gateway_of_this_version_is_understood_wholly(real):
    page = Page()
    sections = all_taken(page, real)
    assert page.answers.not_understood == []
    assert page.lines == []
    assert set(sections) == {"definition", "state", "why", "health", "events"}


@pytest.mark.parametrize("name", NAMES)
def test_each_field_of_another_shape_costs_that_alone_and_the_link_goes_on(real, name):
    kind = getattr(results, name.capitalize())
    others = set(NAMES) - {name, "protocol"}
    count = 0
    for variant in variants(real[name]):
        page = Page()
        sections = all_taken(page, {**real, name: variant.answer})
        assert others <= set(sections), variant
        expected = list(misfits(variant.answer, kind, name))
        named = page.answers.not_understood
        assert not expected or set(named) & set(expected), (str(variant), named)
        assert set(all_taken(page, real)) >= {"state"}, variant
        assert page.answers.not_understood == [], variant
        count += 1
    assert count > 50


def told(page: Page) -> Iterator[dict[str, Any]]:
    return (line for line in page.lines if line["event"] == "not_understood")


def test_what_is_not_understood_is_told_once_with_both_versions(real):
    page = Page()
    older = {key: value for key, value in real["why"].items() if key != "waits"}
    for _ in range(3):
        all_taken(page, real)
        page.take("why", older)
    (event,) = told(page)
    assert event["parts"] == ["why.waits is missing"]
    assert event["page"] == __version__
    assert event["gateway"] == real["health"]["versions"]["vcu_gateway"]


def test_a_mode_of_a_newer_gateway_is_named(real):
    page = Page()
    all_taken(page, {**real, "state": {**real["state"], "mode": "limp"}})
    assert page.answers.not_understood == ["state.mode is 'limp'"]


def test_a_signal_that_is_left_out_shifts_no_other(real):
    page = Page()
    state = json.loads(json.dumps(real["state"]))
    signals = state["messages"]["BMS_Status"]["signals"]
    first, second = signals
    del signals[first]
    row = all_taken(page, {**real, "state": state})["state"]["messages"]["BMS_Status"]
    assert row[4] == [None, pytest.approx(signals[second]["value"], abs=1e-4)]
    assert row[5][0] == "n"


def test_what_json_cannot_say_is_not_sent(real):
    page = Page()
    sections = all_taken(page, {**real, "why": {**real["why"], "sentence": float("nan")}})
    assert "why" not in sections
    assert "why: ValueError" in page.answers.not_understood[-1]


def test_new_fields_are_nothing_to_say(real):
    page = Page()
    all_taken(page, {**real, "why": {**real["why"], "later": 1}})
    assert page.answers.not_understood == []


def test_events_of_another_shape_do_not_fill_the_log(real):
    page = Page()
    for number in range(1000):
        page.take("why", {**real["why"], "mode": f"mode {number}"})
    assert len(list(told(page))) <= 100
