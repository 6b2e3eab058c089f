"""The question that upgrades and removals ask before they begin, to real gateways."""

import contextlib
import os
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.driven import Driven, driven
from tests.packaging.built import BIN, REPOSITORY
from vcu_gateway.client import Client, RefusedError

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
    with gateway.client() as client, client.demand("driver", ttl_ms=1000):
        assert answer_while_active(gateway, client, gateway.socket_path) == YES
        another = tmp_path / "another.sock"
        assert answer_while_active(gateway, client, another, gateway.socket_path) == YES


def answer_while_active(gateway: Driven, client: Client, *sockets: Path, attempts: int = 5) -> int:
    """A machine that stalls may end the drive meanwhile: then the question was another one."""

    def armed() -> bool:
        with contextlib.suppress(RefusedError):
            if gateway.mode == "fault":
                client.reset()
            if gateway.mode == "standby":
                client.arm()
        return gateway.mode == "active"

    for _ in range(attempts):
        gateway.until(armed, "active")
        answer = is_active(*sockets)
        if gateway.mode == "active":  # all the time: nobody else arms it
            return answer
    pytest.fail(f"the gateway did not stay active in {attempts} attempts")


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
