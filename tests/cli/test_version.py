"""`vcu-gateway version`."""

import hashlib
import json
import platform
import socket

import can
import pytest
from click.testing import CliRunner

from vcu_gateway import __version__, cli
from vcu_gateway.protocol import packaged

KEYS = ["vcu-gateway", "python", "python-can", "cantools", "kernel", "dbc_sha256", "can"]


def run(*arguments: str) -> str:
    result = CliRunner().invoke(cli.group, ["version", *arguments], catch_exceptions=False)
    assert result.exit_code == 0
    return result.stdout


def test_the_versions_are_a_line_each():
    assert [line.split()[0] for line in run().splitlines()] == KEYS


def test_the_versions_are_one_json_object():
    facts = json.loads(run("--json"))
    assert [*facts] == [*KEYS, "can_error"]
    assert facts["vcu-gateway"] == __version__
    assert facts["python"] == platform.python_version()
    assert facts["python-can"] == can.__version__
    assert facts["kernel"].startswith("Linux ")
    assert facts["dbc_sha256"] == hashlib.sha256(packaged("vcu.dbc").read_bytes()).hexdigest()
    assert facts["can"] == (facts["can_error"] is None)


class NoCan:
    """A kernel or a Python without CAN."""

    def __init__(self, error: Exception) -> None:
        self.error = error

    def __call__(self, *arguments: object) -> None:
        raise self.error


@pytest.mark.parametrize(
    ("error", "why"),
    [
        (OSError(97, "Address family not supported by protocol"), None),
        (AttributeError("AF_CAN"), "this Python was built without CAN"),
    ],
)
def test_it_says_why_there_is_no_can(monkeypatch, error, why):
    monkeypatch.setattr(socket, "socket", NoCan(error))
    facts = json.loads(run("--json"))
    assert (facts["can"], facts["can_error"]) == (False, why or error.strerror)
    assert run().splitlines()[-1] == f"can no: {why or error.strerror}"


def test_it_says_yes_where_there_is_can(monkeypatch):
    class Socket:
        def __init__(self, *arguments: object) -> None:
            pass

        def close(self) -> None:
            pass

    monkeypatch.setattr(socket, "socket", Socket)
    assert run().splitlines()[-1] == "can yes"
