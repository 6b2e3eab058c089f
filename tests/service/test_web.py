"""The installed page under a real systemd: a user of its own, and a stop that works."""

import contextlib
import json
import os
import pwd
import re
import signal
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.service.unit import PATIENCE_S, Unit, drop_in, systemctl
from tests.vcan.conftest import wait_until

pytestmark = pytest.mark.ci

SERVICE = "vcu-gateway-web.service"
URL = "http://127.0.0.1:9465"
MOST_EXPOSED = 1.5


def show(name: str) -> str:
    return systemctl("show", "--value", f"--property={name}", SERVICE).stdout.strip()


def ask(path: str, method: str = "GET") -> tuple[int, Any]:
    request = urllib.request.Request(f"{URL}{path}", method=method, headers={"Origin": URL})
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


def answers() -> bool:
    try:
        return ask("/")[0] == 200
    except OSError:
        return False


def journal() -> str:
    return subprocess.run(
        ["journalctl", "--unit", SERVICE, "--no-pager", "--output", "cat", "--lines=30"],
        capture_output=True,
        text=True,
    ).stdout


@pytest.fixture(scope="module")
def page() -> Iterator[None]:
    """The service, started by hand as whoever wants it does; each test leaves it as it was."""
    started = systemctl("start", SERVICE)
    assert started.returncode == 0, started.stderr
    wait_until(answers, "the page", PATIENCE_S)
    yield
    systemctl("stop", SERVICE)


@contextlib.contextmanager
def restarted_with(options: str) -> Iterator[None]:
    """The page with these options for a while."""
    try:
        with drop_in(f'[Service]\nEnvironment="WEB_OPTIONS={options}"\n', SERVICE):
            systemctl("restart", SERVICE)
            yield
    finally:
        systemctl("reset-failed", SERVICE)
        systemctl("restart", SERVICE)
        wait_until(answers, "the page", PATIENCE_S)


def test_the_package_does_not_enable_it():
    assert show("UnitFileState") == "disabled"


def test_it_is_its_own_user_and_is_hardly_exposed(page: None):
    pid = int(show("MainPID"))
    assert os.stat(f"/proc/{pid}").st_uid == pwd.getpwnam("vcu-gateway-web").pw_uid
    done = subprocess.run(
        ["systemd-analyze", "security", "--no-pager", SERVICE], capture_output=True, text=True
    )
    found = re.search(r"Overall exposure level for \S+: ([0-9.]+)", done.stdout)
    assert found, done.stderr
    assert float(found[1]) <= MOST_EXPOSED
    runtime = Path("/run/vcu-gateway-web").stat()
    assert runtime.st_mode & 0o077 == 0


def test_whoever_is_on_the_machine_looks_and_stops_and_no_more(steady: Unit, page: None):
    def seen() -> bool:
        return (
            json.loads(ask("/api/session")[1])["role"] == "viewer" and "gateway_found" in journal()
        )

    wait_until(seen, journal(), PATIENCE_S)
    assert ask("/api/actions/arm", "POST")[0] == 403
    status, body = ask("/api/actions/estop", "POST")
    assert status == 200, body
    assert json.loads(body)["granted"] is True


def test_its_rights_are_none_until_the_configuration_gives_some(steady: Unit, page: None):
    with restarted_with("--local-role service"):
        wait_until(answers, "the page", PATIENCE_S)
        status, body = ask("/api/actions/arm", "POST")
    assert status == 409
    assert "arm needs the right 'operate'" in json.loads(body)["sentence"]


def test_killed_it_is_back_at_once_and_the_gateway_goes_on(steady: Unit, page: None):
    pid = int(show("MainPID"))
    os.kill(pid, signal.SIGKILL)
    begin_s = time.monotonic()
    wait_until(lambda: answers() and int(show("MainPID")) != pid, "a new one", PATIENCE_S)
    assert time.monotonic() - begin_s < 20
    assert steady.show("ActiveState") == "active"
    assert steady.number("NRestarts") == 0


def test_an_address_on_a_network_without_tls_does_not_start(page: None):
    with restarted_with("--listen 0.0.0.0:9465"):
        wait_until(lambda: show("ActiveState") == "failed", journal(), PATIENCE_S)
        assert show("ExecMainStatus") == str(os.EX_CONFIG)
    assert "there is no TLS" in journal()


def test_a_port_that_another_program_has_is_an_error_and_no_page_about_to_come(page: None):
    systemctl("stop", SERVICE)
    try:
        with socket.create_server(("127.0.0.1", 9465)):
            systemctl("start", SERVICE)
            wait_until(lambda: show("ActiveState") == "failed", journal(), PATIENCE_S)
            assert show("ExecMainStatus") == str(os.EX_UNAVAILABLE)
            assert show("NRestarts") == "0"
            assert "cannot listen on 127.0.0.1 port 9465" in journal()
    finally:
        systemctl("reset-failed", SERVICE)
        systemctl("start", SERVICE)
        wait_until(answers, "the page", PATIENCE_S)
