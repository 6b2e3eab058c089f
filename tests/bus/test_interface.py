"""What the kernel is asked of an interface, and the lock: no CAN is needed for either."""

import contextlib
import os
import pwd
import signal
import socket
import struct
import subprocess
import sys
import threading
import uuid
from collections.abc import Iterator

import pytest

from vcu_gateway.bus import connection as instance_lock
from vcu_gateway.bus import netlink
from vcu_gateway.bus.connection import BusConnection, BusSettings, InstanceLock
from vcu_gateway.bus.interface import Interfaces
from vcu_gateway.bus.netlink import InterfaceDetails, described
from vcu_gateway.core.link import LinkState
from vcu_gateway.errors import UnavailableError


def test_the_loopback_interface_is_up_and_no_can():
    interfaces = Interfaces()
    found = interfaces.look("lo")
    assert (found.up, found.is_can) == (True, False)
    assert found.number == socket.if_nametoindex("lo")
    assert interfaces.name_of(found.number) == "lo"
    interfaces.close()


def test_an_interface_that_is_not_there_is_none():
    interfaces = Interfaces()
    assert interfaces.look("nocan9") is None
    assert interfaces.name_of(99_999) is None
    interfaces.close()


def test_looking_costs_no_further_descriptor():
    interfaces = Interfaces()
    interfaces.look("lo")
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(100):
        interfaces.look("lo")
    assert len(os.listdir("/proc/self/fd")) <= before  # the collector may close those of others
    interfaces.close()


# The kernel's answer to RTM_GETLINK, of a controller: include/uapi/linux/can/netlink.h.


def attribute(kind: int, value: bytes) -> bytes:
    return struct.pack("=HH", 4 + len(value), kind) + value + bytes(-len(value) % 4)


def answer(flags: int, *attributes: bytes) -> bytes:
    body = struct.pack("=BxHiII", 0, 280, 3, flags, 0) + b"".join(attributes)
    return struct.pack("=IHHII", 16 + len(body), 16, 0, 1, 0) + body


def controller(state: int, bit_rate: int) -> bytes:
    timing = attribute(1, struct.pack("=8I", bit_rate, 875, 0, 0, 0, 0, 0, 0))
    data = timing + attribute(4, struct.pack("=I", state))
    return attribute(18, attribute(1, b"can\0") + attribute(2 | 0x8000, data))


@pytest.mark.parametrize(
    ("state", "meaning"),
    [
        (0, LinkState.UP),
        (1, LinkState.WARNING),
        (2, LinkState.PASSIVE),
        (3, LinkState.BUS_OFF),
        (4, None),  # stopped
        (9, None),
    ],
)
def test_a_controller_tells_its_state_bit_rate_echo_and_carrier(state, meaning):
    queue = attribute(6, b"pfifo_fast\0")
    told = answer(0x40000 | 0x10000 | 0x41, attribute(3, b"can0\0"), queue)
    assert described(told).details == InterfaceDetails(True, True, None, None, True)
    told = answer(0x41, queue, controller(state, 250_000))
    assert described(told).details == InterfaceDetails(False, True, meaning, 250_000, False)


def test_an_interface_without_a_queue_is_known():
    assert described(answer(0x41, attribute(6, b"noqueue\0"))).details.queue_is_used is False
    assert described(answer(0x41)).details.queue_is_used is None


def test_a_bit_rate_that_was_not_set_is_not_known():
    assert described(answer(0x41, controller(0, 0))).details.bit_rate_bit_s is None


@pytest.mark.parametrize("length", range(120))
def test_a_torn_answer_is_no_more_than_unknown(length):
    whole = answer(0x41, attribute(6, b"noqueue\0"), controller(2, 250_000))
    try:
        told = described(whole[:length]).details
    except struct.error:
        return
    assert set(told) <= {None, True, False, LinkState.PASSIVE, 250_000}


def test_an_attribute_shorter_than_its_head_ends_the_reading():
    assert described(answer(0x41, struct.pack("=HH", 0, 6) * 20)).details.queue_is_used is None


def test_asking_about_the_loopback_or_about_nothing_raises_nothing():
    assert netlink.details("lo").state is None
    assert netlink.details("nocan9") == InterfaceDetails()


# The lock.


@pytest.fixture
def channel() -> str:
    return f"t{uuid.uuid4().hex[:12]}"


def test_a_second_gateway_of_this_machine_is_refused_by_name_of_the_first(channel):
    first = InstanceLock(channel)
    with pytest.raises(UnavailableError) as caught:
        InstanceLock(channel)
    assert str(caught.value) == (
        f"another gateway, process {os.getpid()}, commands on {channel} already; a second one"
        " would fight it; stop that one first, or set bus.channel to another interface"
    )
    assert caught.value.exit_code == 69
    InstanceLock(f"{channel}x").release()
    first.release()
    InstanceLock(channel).release()


def test_a_hundred_refusals_do_not_wear_it_out(channel):
    first = InstanceLock(channel)
    for _ in range(100):
        with pytest.raises(UnavailableError, match="another gateway"):
            InstanceLock(channel)
    first.release()


def test_a_gateway_that_was_killed_leaves_no_lock_behind(channel):
    program = (
        "from vcu_gateway.bus.connection import InstanceLock;"
        f" c = InstanceLock({channel!r});print(flush=True); input()"
    )
    child = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    child.stdout.readline()
    with pytest.raises(UnavailableError, match=f"process {child.pid},"):
        InstanceLock(channel)
    child.kill()
    child.communicate()
    InstanceLock(channel).release()


@contextlib.contextmanager
def holder(channel: str, kind: str, user: int | None = None) -> Iterator[int]:
    """A process that has the name before any gateway; its number."""
    program = f"""
import os, socket
if {user!r} is not None:
    os.setgid({user!r}); os.setuid({user!r})
held = socket.socket(socket.AF_UNIX)
held.bind(b"\\0vcu-gateway/" + {channel!r}.encode())
if {kind!r} in ("listens", "is full"):
    held.listen(0)
if {kind!r} == "is full":
    asking = socket.socket(socket.AF_UNIX)
    asking.connect(held.getsockname())
print(flush=True)
input()
"""
    child = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert child.stdout.readline()
    try:
        yield child.pid
    finally:
        with contextlib.suppress(BrokenPipeError):
            child.communicate(b"\n")


NOBODY = 65534
ONLY_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")


@ONLY_ROOT
def test_a_name_that_another_user_holds_is_passed_by_and_says_who(channel):
    with holder(channel, "listens", NOBODY) as pid:
        lock = InstanceLock(channel)
        assert lock.passed_by == f"process {pid} of user {NOBODY}"
        lock.answer()
        lock.release()


@ONLY_ROOT
def test_the_services_own_account_is_honoured(channel, monkeypatch):
    monkeypatch.setattr(instance_lock, "_SERVICE_ACCOUNT", pwd.getpwuid(NOBODY).pw_name)
    with (
        holder(channel, "listens", NOBODY) as pid,
        pytest.raises(UnavailableError, match=f"process {pid},"),
    ):
        InstanceLock(channel)


@pytest.mark.parametrize("kind", ["is bound", "is full"])
def test_a_name_whose_holder_cannot_be_asked_is_passed_by(channel, kind):
    with holder(channel, kind):
        assert "does not answer" in str(InstanceLock(channel).passed_by)


def test_a_holder_that_ends_while_it_is_asked_leaves_the_name_to_us(channel):
    with holder(channel, "is bound") as pid:
        threading.Timer(0.03, os.kill, (pid, signal.SIGKILL)).start()
        first = InstanceLock(channel)
    if first.passed_by is None:  # else the machine stalled
        with pytest.raises(UnavailableError):
            InstanceLock(channel)
    first.release()


def test_a_gateway_answers_however_many_ask(channel):
    connection = BusConnection(BusSettings("socketcan", channel), (), lambda frame: None)
    connection.acquire_lock()
    for _ in range(5):
        for _ in range(100):
            with pytest.raises(UnavailableError, match="another gateway"):
                InstanceLock(channel)
        connection.instance_lock.answer()
    assert connection.instance_lock.passed_by is None
    lock = connection.instance_lock
    connection.release_lock()
    lock.answer()


def test_only_a_network_interface_is_locked_and_only_once(channel):
    connection = BusConnection(BusSettings("socketcan", channel), (), lambda frame: None)
    connection.acquire_lock()
    connection.acquire_lock()
    virtual = BusConnection(BusSettings("virtual", channel), (), lambda frame: None)
    virtual.acquire_lock()
    virtual.release_lock()
    with pytest.raises(UnavailableError):
        InstanceLock(channel)
    connection.release_lock()
    InstanceLock(channel).release()
