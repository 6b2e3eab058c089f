"""The running gateway: a real one on the virtual bus; break one thing of what it answers."""

import copy
import os
import socket
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.doctor.judged import not_ok, only, well
from tests.driven import Driven, driven, wait_until
from vcu_gateway import config as configuration
from vcu_gateway.client import Client
from vcu_gateway.config.model import ApiSection
from vcu_gateway.doctor import running_gateway
from vcu_gateway.doctor.running_gateway import GatewayFacts, judge

PATIENCE_S = 60


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Driven]:
    with driven(tmp_path_factory.mktemp("running")) as one:
        one.until_ready()
        yield one


@pytest.fixture
def healthy(running: Driven) -> GatewayFacts:
    """Its figures may come from a busy machine: no tick was skipped, no frame dropped."""
    found: list[GatewayFacts] = []

    def in_standby() -> bool:
        """A stall may keep the answer for too long, or a message of the vehicle."""
        found[:] = [running_gateway.read(configuration.load(running.file), expected=True)]
        answers: Any = found[0].answers
        return isinstance(answers, tuple) and answers[0]["mode"] == "standby"

    wait_until(in_standby, "an answer in standby", PATIENCE_S)
    answers: Any = copy.deepcopy(found[0].answers)
    why, health = answers
    health["ticks"]["skipped"] = health["frames"]["dropped"] = 0
    return found[0]._replace(answers=(why, health))


def changed(facts: GatewayFacts, section: str, **values: Any) -> GatewayFacts:
    answers: Any = facts.answers
    why, health = answers
    target = why if section == "why" else health if section == "health" else health[section]
    target.update(values)
    return facts


def test_a_gateway_in_standby_is_well_and_its_process_known(healthy):
    assert not_ok(judge(healthy)) == {}
    assert healthy.pid == os.getpid()
    assert "no tick of" in well(judge(healthy))
    assert "configuration as on disk" in well(judge(healthy))


@pytest.mark.parametrize(
    ("section", "values", "check", "kind"),
    [
        ("why", {"mode": "fault"}, "mode", "wrong"),
        ("why", {"mode": "starting"}, "mode", "warning"),
        ("why", {"mode": "stopping"}, "mode", "warning"),
        ("link", {"state": "error warning"}, "link", "warning"),
        ("link", {"state": "error passive"}, "link", "wrong"),
        ("link", {"state": "bus off"}, "link", "wrong"),
        ("link", {"state": "lost", "lost": "can0 is down"}, "link", "wrong"),
        ("ticks", {"skipped": 1}, "ticks", "warning"),
        ("frames", {"dropped": 1}, "frames", "warning"),
        ("health", {"config_digest": "0"}, "config_digest", "warning"),
        ("health", {"config_file": "/etc/other.yaml"}, "config_file", "warning"),
        ("health", {"config_file": "other.yaml"}, "config_file", "warning"),
    ],
)
def test_each_trouble_of_a_running_gateway_is_one_finding(healthy, section, values, check, kind):
    found = only(judge(changed(healthy, section, **values)))
    assert (found.subject, found.check, found.kind.value) == ("gateway", check, kind)
    assert found.remedy


def test_while_somebody_drives_nothing_is_to_be_changed(healthy):
    findings = list(judge(changed(healthy, "why", mode="active")))
    assert not_ok(findings) == {}
    assert "it is driving: change nothing now" in well(findings)


@pytest.mark.parametrize(
    ("section", "values"),
    [("frames", {"dropped": None}), ("health", {"config_file": "gateway.yaml"})],
)
def test_what_cannot_be_known_is_not_complained_of(healthy, section, values):
    assert not_ok(judge(changed(healthy, section, **values))) == {}


def test_only_two_requests_are_made_and_none_that_changes(running):
    asked: list[tuple[int, int]] = []

    def answered() -> bool:
        """Within its half second; where that is missed, it is asked and counted again."""
        with Client(running.socket_path, timeout_s=PATIENCE_S) as client:
            before: Any = client.health()["api"]
            facts = running_gateway.read(configuration.load(running.file), expected=True)
            after: Any = client.health()["api"]
        counted = ("accepted", "requests")
        asked[:] = [tuple(after[name] - before[name] for name in counted)]
        return isinstance(facts.answers, tuple)

    wait_until(answered, "an answer", PATIENCE_S)
    assert asked == [(1, 3)], "one connection; two requests, and the one that counted them"


def at(path: Path, expected: bool) -> GatewayFacts:
    api = ApiSection(socket_path=str(path))
    return running_gateway.read(configuration.Config(api=api), expected)


def test_no_gateway_is_well_unless_one_ought_to_answer(tmp_path):
    assert not_ok(judge(at(tmp_path / "none.sock", expected=False))) == {}
    found = only(judge(at(tmp_path / "none.sock", expected=True)))
    assert (found.check, found.kind.value) == ("answers", "wrong")


def test_one_that_hangs_is_given_half_a_second(tmp_path):
    path = tmp_path / "deaf.sock"
    with socket.socket(socket.AF_UNIX) as deaf:
        deaf.bind(str(path))
        deaf.listen()
        found = only(judge(at(path, expected=True)))
    assert "within 0.5 s" in found.what


@pytest.mark.skipif(os.geteuid() != 0, reason="root alone can become another user")
def test_a_socket_that_this_user_may_not_open_is_unknown(tmp_path):
    path = tmp_path / "control.sock"
    os.chmod(tmp_path, 0o700)
    with socket.socket(socket.AF_UNIX) as private:
        private.bind(str(path))
        private.listen()
        os.seteuid(65534)
        try:
            facts = at(path, expected=True)
        finally:
            os.seteuid(0)
    assert not_ok(judge(facts)) == {"answers": "unknown"}


def test_a_gateway_without_an_api_is_well():
    api = ApiSection(enabled=False)
    assert not_ok(judge(running_gateway.read(configuration.Config(api=api), expected=True))) == {}
