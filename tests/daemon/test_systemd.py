"""What systemd is told, read at the other end of a real socket."""

import socket

import pytest

from vcu_gateway.daemon.systemd import SystemdNotifier


@pytest.fixture
def manager_socket(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager_socket:
        manager_socket.bind(str(tmp_path / "notify"))
        manager_socket.setblocking(False)
        yield manager_socket


def manager_of(manager_socket: socket.socket, **more: str) -> SystemdNotifier:
    address = manager_socket.getsockname()
    if isinstance(address, bytes):
        address = "@" + address[1:].decode()
    return SystemdNotifier({"NOTIFY_SOCKET": address, **more}, 100)


def test_each_word_is_one_datagram(manager_socket):
    manager = manager_of(manager_socket)
    manager.notify("READY=1")
    manager.status("standby; arm")
    assert manager_socket.recv(1000) == b"READY=1"
    assert manager_socket.recv(1000) == b"STATUS=standby; arm"


def test_an_abstract_address_is_understood():
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager_socket:
        manager_socket.bind("")  # the kernel chooses a name that nobody else has
        manager_socket.setblocking(False)
        manager_of(manager_socket).notify("READY=1")
        assert manager_socket.recv(1000) == b"READY=1"


def test_a_status_is_one_line_of_bounded_length(manager_socket):
    manager_of(manager_socket).status("two\nlines\0and\n" + "x" * 1000)
    told = manager_socket.recv(4000)
    assert b"\n" not in told
    assert len(told) < 600


def test_nothing_waits_for_a_manager_that_does_not_read(manager_socket):
    manager = manager_of(manager_socket)
    for _ in range(5000):
        manager.notify("WATCHDOG=1")


def test_a_manager_that_is_gone_is_no_trouble(manager_socket):
    manager = manager_of(manager_socket)
    manager_socket.close()
    manager.notify("READY=1")


@pytest.mark.parametrize("address", ["", "/nowhere/notify", "x" * 200, "a\0b", "vsock:2:1234"])
def test_without_a_manager_everything_is_silent(address):
    manager = SystemdNotifier({"NOTIFY_SOCKET": address}, 100)
    manager.notify("READY=1")
    manager.status("nobody hears this")
    assert manager.watchdog_ns is None


@pytest.mark.parametrize(
    ("environment", "watchdog_ns"),
    [
        ({}, None),
        ({"WATCHDOG_USEC": "2000000"}, 2_000_000_000),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "100"}, 2_000_000_000),
        ({"WATCHDOG_USEC": "2000000", "WATCHDOG_PID": "101"}, None),
        ({"WATCHDOG_USEC": "0"}, None),
        ({"WATCHDOG_USEC": "-5"}, None),
        ({"WATCHDOG_USEC": "2s"}, None),
        ({"WATCHDOG_USEC": "٢"}, None),
    ],
)
def test_the_watchdog_is_the_one_set_for_this_process(manager_socket, environment, watchdog_ns):
    assert manager_of(manager_socket, **environment).watchdog_ns == watchdog_ns
