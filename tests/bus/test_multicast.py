"""A bus over UDP multicast: own frames are told from those of others."""

import socket
import time
import uuid
from collections.abc import Callable, Iterator

import can
import pytest
from can.interfaces.udp_multicast import UdpMulticastBus, utils

from vcu_gateway.bus.connection import BusConnection, BusSettings
from vcu_gateway.bus.multicast import _REMEMBERED, EchoingMulticastBus
from vcu_gateway.bus.settings import BusCounters
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.errors import UnavailableError

PORT = 43113
COMMAND = OutFrame("PCU1", 0x0008A7D0, bytes.fromhex("0c000000e02e0000"))
PATIENCE_S = 30.0


def own_group() -> str:
    """Of this test alone: 239.192.0.0/14 is the organization's own."""
    one = uuid.uuid4().bytes
    return f"239.{192 + one[0] % 4}.{one[1]}.{1 + one[2] % 254}"


@pytest.fixture
def group() -> str:
    address = own_group()
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.sendto(b"", (address, PORT))
    except OSError as error:
        pytest.skip(f"no multicast on this machine: {error}; tests/vcan has it in the lab")
    return address


@pytest.fixture
def frames() -> list[Frame]:
    return []


@pytest.fixture
def connection(group: str, frames: list[Frame]) -> Iterator[BusConnection]:
    connection = BusConnection(
        BusSettings("udp_multicast", group), [COMMAND.can_id, 0x1808D0F4], frames.append
    )
    connection.open()
    connection.start_sending()
    yield connection
    connection.close()


@pytest.fixture
def other(group: str, connection: BusConnection) -> Iterator[can.BusABC]:
    with can.Bus(interface="udp_multicast", channel=group) as bus:
        yield bus


def read_until(condition: Callable[[], bool], *connections: BusConnection) -> None:
    """Read them until this holds, as ticking threads do."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s
        for one in connections:
            one.read_waiting(time.monotonic_ns())
        time.sleep(0.005)


def test_a_sent_frame_comes_back_as_our_own_echo_and_reaches_others(connection, other, frames):
    for _ in range(3):
        assert connection.send(COMMAND)
    read_until(lambda: len(frames) == 3, connection)
    assert all(frame.own_echo for frame in frames)
    seen = other.recv(PATIENCE_S)
    assert (seen.arbitration_id, bytes(seen.data)) == (COMMAND.can_id, COMMAND.data)


def test_the_same_frame_of_another_node_is_no_echo(connection, other, frames):
    assert connection.send(COMMAND)
    other.send(can.Message(arbitration_id=COMMAND.can_id, data=COMMAND.data))
    assert connection.send(COMMAND)
    read_until(lambda: len(frames) == 3, connection)
    assert [frame.own_echo for frame in frames] == [True, False, True]


def test_two_gateways_tell_their_frames_apart(connection, group, frames):
    others: list[Frame] = []
    second = BusConnection(BusSettings("udp_multicast", group), [COMMAND.can_id], others.append)
    second.open()
    second.start_sending()
    for _ in range(50):
        assert connection.send(COMMAND)
        assert second.send(COMMAND)
    read_until(lambda: len(frames) == len(others) == 100, connection, second)
    second.close()
    for heard in (frames, others):
        assert sum(frame.own_echo for frame in heard) == 50


def test_a_datagram_of_ours_that_somebody_repeats_is_another_senders(group):
    bus = EchoingMulticastBus(group, None, BusCounters())
    with UdpMulticastBus(group) as listener:
        bus.send(can.Message(arbitration_id=COMMAND.can_id, data=COMMAND.data))
        datagram, _, _ = listener._multicast.recv(PATIENCE_S)
    assert not bus.recv(PATIENCE_S).is_rx
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as repeater:
        repeater.sendto(datagram, (group, PORT))
    assert bus.recv(PATIENCE_S).is_rx
    bus.shutdown()


def test_a_frame_cannot_say_of_itself_that_it_is_ours(connection, group, frames):
    import msgpack

    datagram = utils.pack_message(can.Message(arbitration_id=COMMAND.can_id, data=COMMAND.data))
    forged = msgpack.packb({**msgpack.unpackb(datagram), "is_rx": False})
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as liar:
        liar.sendto(forged, (group, PORT))
    read_until(lambda: len(frames) == 1, connection)
    assert not frames[0].own_echo


def test_what_holds_no_frame_is_counted_and_the_bus_goes_on(connection, other, group, frames):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        for junk in (b"", b"\x00", b"hello", b"\x81\xa1x\x01", b"\xc1" * 100):
            stranger.sendto(junk, (group, PORT))
    other.send(can.Message(arbitration_id=0x1808D0F4, data=bytes(8)))
    read_until(lambda: len(frames) == 1, connection)
    assert connection.is_open
    assert connection.counters.undecodable == 5


def test_what_never_comes_back_is_forgotten_but_for_the_last(group):
    bus = EchoingMulticastBus(group, None, BusCounters())
    for _ in range(3 * _REMEMBERED):
        bus.send(can.Message(arbitration_id=COMMAND.can_id, data=COMMAND.data))
    assert len(bus._sent) == _REMEMBERED
    bus.shutdown()


def test_without_msgpack_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setattr(utils, "msgpack", None)
    connection = BusConnection(
        BusSettings("udp_multicast", "239.192.1.1"), [COMMAND.can_id], lambda frame: None
    )
    with pytest.raises(UnavailableError, match=r"pip install 'vcu-gateway\[multicast\]'"):
        connection.open()
