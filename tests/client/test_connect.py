"""The way in: where the gateway is looked for, and what is said where it is not found."""

import contextlib
import errno
import os
import socket
import threading
import time
from pathlib import Path

import pytest

from vcu_gateway.client import Client, UnreachableError, default_socket_path
from vcu_gateway.client.jsonrpc import connect


@pytest.fixture
def path(tmp_path):
    return tmp_path / "control.sock"


@pytest.fixture
def listener(path):
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        yield listener


def test_the_gateway_is_looked_for_under_run(monkeypatch):
    monkeypatch.delenv("VCU_GATEWAY_SOCKET", raising=False)
    assert default_socket_path() == Path("/run/vcu-gateway/control.sock")


def test_the_environment_names_another_place(monkeypatch):
    monkeypatch.setenv("VCU_GATEWAY_SOCKET", "/tmp/other.sock")
    assert default_socket_path() == Path("/tmp/other.sock")
    assert Client().socket_path == Path("/tmp/other.sock")


def test_an_empty_environment_variable_is_none(monkeypatch):
    monkeypatch.setenv("VCU_GATEWAY_SOCKET", "")
    assert default_socket_path() == Path("/run/vcu-gateway/control.sock")


def test_a_given_path_wins(monkeypatch):
    monkeypatch.setenv("VCU_GATEWAY_SOCKET", "/tmp/other.sock")
    assert Client("/tmp/mine.sock").socket_path == Path("/tmp/mine.sock")


def test_a_missing_socket_says_to_start_the_gateway(path):
    with pytest.raises(UnreachableError, match=r"no socket .*control\.sock.*systemctl start"):
        connect(path)


def test_a_socket_that_nobody_listens_at_says_that_the_gateway_has_ended(path, listener):
    with pytest.raises(UnreachableError, match=r"no process listens.*systemctl start"):
        connect(path)


def test_a_socket_of_others_says_which_group_to_join(path, listener):
    listener.listen()
    path.chmod(0)
    if os.geteuid() != 0:
        with pytest.raises(UnreachableError, match="group"):
            connect(path)
        return
    assert _in_a_child_without_rights(path) == 0


def _in_a_child_without_rights(path):
    """0 where the refusal speaks of the group. Root may open everything, hence the child."""
    pid = os.fork()
    if pid:
        return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    code = 2
    try:
        os.chdir(path.parent)
        os.setgroups([])
        os.setuid(65534)
        connect(Path(path.name))
    except UnreachableError as error:
        code = 0 if "group" in str(error) else 1
    finally:
        os._exit(code)


def test_a_queue_that_is_full_says_that_the_gateway_hangs(path, listener):
    listener.listen(0)
    with contextlib.ExitStack() as waiting:

        def crowd():
            for _ in range(100):
                waiting.enter_context(connect(path))

        with pytest.raises(UnreachableError, match="no more connections"):
            crowd()


def test_a_path_that_is_too_long_is_unreachable_like_any_other():
    with pytest.raises(UnreachableError, match="too long"):
        connect(Path("/tmp/" + "x" * 200))


def test_a_plain_file_is_no_gateway(path):
    path.write_text("")
    with pytest.raises(UnreachableError):
        connect(path)


def test_the_cause_is_kept_for_those_who_look(path):
    with pytest.raises(UnreachableError) as raised:
        connect(path)
    assert isinstance(raised.value.__cause__, OSError)
    assert raised.value.__cause__.errno == errno.ENOENT


def test_trying_in_vain_leaves_nothing_open(path):
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(UnreachableError) as raised:
        connect(path)
    assert raised.value.__traceback__  # It holds on to what connect() had in its hands.
    assert len(os.listdir("/proc/self/fd")) == before


def test_where_others_crowd_in_it_waits_for_its_turn_and_no_longer(path, listener):
    listener.listen(0)
    with socket.socket(socket.AF_UNIX) as other:
        other.connect(str(path))  # the backlog is full now
        begun_s = time.monotonic()
        with pytest.raises(UnreachableError, match="takes no more connections"):
            connect(path, 0.3)
        assert 0.25 < time.monotonic() - begun_s < 5
        threading.Timer(0.3, listener.accept).start()
        with connect(path, 60.0) as connection:
            assert not connection.getblocking()
