"""The question that upgrades and removals ask before they begin, to real gateways."""

import os
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.driven import Driven, driven
from tests.packaging.built import BIN, REPOSITORY

YES, NO = 0, 1


@pytest.fixture
def gateway(tmp_path: Path) -> Iterator[Driven]:
    with driven(tmp_path) as one:
        one.until_ready()
        yield one


def is_active(*sockets: Path) -> int:
    return subprocess.run(
        [REPOSITORY / "packaging" / "is-active", *sockets],
        env={**os.environ, "VCU_GATEWAY": str(BIN / "vcu-gateway")},
    ).returncode


def test_an_armed_gateway_is(gateway, tmp_path):
    with gateway.client() as client, client.demand("driver"):
        client.arm()
        gateway.until_mode("active")
        assert is_active(gateway.socket_path) == YES
        assert is_active(tmp_path / "another.sock", gateway.socket_path) == YES


def test_one_in_standby_is_not(gateway):
    assert is_active(gateway.socket_path) == NO


def test_where_none_runs_none_is(tmp_path):
    assert is_active(tmp_path / "control.sock") == NO


def test_one_that_does_not_answer_holds_nobody_up(tmp_path):
    path = tmp_path / "control.sock"
    with socket.socket(socket.AF_UNIX) as silent:
        silent.bind(str(path))
        silent.listen()
        assert is_active(path) == NO


def test_nonsense_is_no_answer(tmp_path):
    with open(tmp_path / "control.sock", "w") as file:
        file.write("active")
    assert is_active(tmp_path / "control.sock") == NO
