"""Opening the sockets: who can reach them, what stands in the way, what is left behind."""

import os
import socket
import stat

import pytest

from tests.server.conftest import a_stranger
from vcu_gateway.api.errors import Policy
from vcu_gateway.errors import UnavailableError
from vcu_gateway.server.acceptor import UnixListener
from vcu_gateway.server.service import ServerSettings

POLICY = Policy(own_uid=os.geteuid())

as_root = pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a socket away")


@pytest.fixture
def path(folder):
    return folder / "control.sock"


def refusal(path, **settings) -> str:
    with pytest.raises(UnavailableError) as caught:
        UnixListener(ServerSettings(path, POLICY, **settings))
    (problem,) = caught.value.problems
    assert problem.remedy, problem
    return str(problem)


def listener_at(path) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    sock.bind(os.fspath(path))
    return sock


def test_owner_and_group_may_open_the_socket_and_nobody_else(path):
    old = os.umask(0o077)
    try:
        listener = UnixListener(ServerSettings(path, POLICY))
    finally:
        os.umask(old)
    assert stat.S_IMODE(path.stat().st_mode) == 0o660
    listener.close()


def test_the_mode_is_the_configured_one(path):
    listener = UnixListener(ServerSettings(path, POLICY, mode=0o600))
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    listener.close()


@as_root
@pytest.mark.parametrize(("owner", "group"), [(12345, 23456), (12345, None), (None, 23456)])
def test_owner_and_group_are_set_by_number(path, owner, group):
    listener = UnixListener(ServerSettings(path, POLICY, owner, group))
    assert path.stat().st_uid == (os.geteuid() if owner is None else owner)
    assert path.stat().st_gid == (os.getegid() if group is None else group)
    listener.close()


def test_owner_and_group_are_left_where_none_is_named(path):
    listener = UnixListener(ServerSettings(path, POLICY))
    assert (path.stat().st_uid, path.stat().st_gid) == (os.geteuid(), os.getegid())
    listener.close()


def test_a_path_that_is_too_long_is_reported_with_its_length(folder):
    path = folder / ("s" * (108 - len(os.fspath(folder)) - 1))
    assert "108 bytes" in refusal(path)
    fits = path.with_name(path.name[1:])
    UnixListener(ServerSettings(fits, POLICY)).close()


def test_a_missing_folder_is_reported(folder):
    assert f"create the folder {folder}/none" in refusal(folder / "none" / "control.sock")


def test_a_file_in_the_way_is_reported_and_stays(path):
    path.write_text("precious")
    assert "is no socket" in refusal(path)
    assert path.read_text() == "precious"


def test_a_link_in_the_way_is_reported_and_stays(path, folder):
    path.symlink_to(folder / "elsewhere")
    assert "is no socket" in refusal(path)
    assert path.is_symlink()


def test_a_folder_that_cannot_be_written_is_reported(folder):
    path = folder / "closed"
    path.mkdir(mode=0o555)
    with a_stranger():
        assert f"must be able to write into {path}" in refusal(path / "control.sock")


def test_a_socket_that_an_earlier_run_left_behind_is_replaced(path):
    listener_at(path).close()
    assert path.is_socket()
    listener = UnixListener(ServerSettings(path, POLICY))
    with socket.socket(socket.AF_UNIX) as client:
        client.connect(os.fspath(path))
    listener.close()


@pytest.mark.parametrize("waiting", [0, 1])
def test_a_socket_where_another_process_answers_is_left_alone(path, waiting):
    with listener_at(path) as other:
        other.listen(0)
        clients = [socket.socket(socket.AF_UNIX) for _ in range(waiting)]
        for client in clients:
            client.connect(os.fspath(path))  # now its backlog is full
        inode = path.stat().st_ino
        assert "another process answers" in refusal(path)
        assert path.stat().st_ino == inode
        for client in clients:
            client.close()


def test_a_socket_of_another_kind_is_left_alone(path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as other:
        other.bind(os.fspath(path))
        refusal(path)
        assert path.is_socket()


def test_a_socket_that_may_not_be_opened_is_left_alone(path, folder):
    with listener_at(path) as other:
        other.listen()
        path.chmod(0)
        folder.chmod(0o777)
        with a_stranger():
            assert "Permission denied" in refusal(path)
        assert path.is_socket()


def test_a_left_over_socket_that_cannot_be_removed_is_reported(path):
    listener_at(path).close()
    path.chmod(0o777)
    path.parent.chmod(0o555)
    with a_stranger():
        assert f"{path} is left over, and cannot be removed" in refusal(path)
    path.parent.chmod(0o755)
    assert path.is_socket()


def test_a_path_with_a_zero_byte_is_reported(folder):
    assert "cannot be a socket" in refusal(folder / "a\0b")


def test_a_refusal_leaves_no_descriptor_behind(path):
    path.mkdir()
    files = len(os.listdir("/proc/self/fd"))
    for _ in range(3):
        refusal(path / "none" / "control.sock")
        refusal(path)
    assert len(os.listdir("/proc/self/fd")) <= files  # the collector may close those of others


def test_without_privileges_the_socket_stays_its_makers(path, folder):
    folder.chmod(0o777)
    with a_stranger():
        listener = UnixListener(ServerSettings(path, POLICY))
        assert path.stat().st_uid == os.geteuid()
        assert "CAP_CHOWN" in refusal(path.with_name("other"), owner=0 if os.geteuid() else 1)
        listener.close()
    assert not any(folder.iterdir())


def test_closing_removes_the_socket(path):
    listener = UnixListener(ServerSettings(path, POLICY))
    listener.close()
    assert not path.exists()
    listener.close()


def test_closing_leaves_the_socket_of_a_successor_alone(path):
    listener = UnixListener(ServerSettings(path, POLICY))
    path.unlink()
    successor = UnixListener(ServerSettings(path, POLICY))
    listener.close()
    assert path.is_socket()
    successor.close()
