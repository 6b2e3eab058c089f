"""The bus connection on python-can's virtual bus: frames in, frames out, failures reported once."""

import errno
import threading
import time
import uuid
from collections.abc import Callable

import can
import pytest

from vcu_gateway.bus.connection import BusConnection, BusSettings, kernel_filters
from vcu_gateway.bus.reader import PlainBus
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.errors import UnavailableError

PATIENCE_S = 30.0
COMMAND = OutFrame("PCU1", 0x0008A7D0, bytes.fromhex("0c000000e02e0000"))


def quickest_ns(call: Callable[[], object]) -> int:
    """Of a few calls: the machine may stand still in one, what waits does so in each."""
    took_ns = []
    for _ in range(20):
        began_ns = time.monotonic_ns()
        call()
        took_ns.append(time.monotonic_ns() - began_ns)
    return min(took_ns)


class Received:
    """Frames that a connection has taken in; reads it, as the ticking thread does."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.connection: BusConnection | None = None

    def __call__(self, frame: Frame) -> None:
        self.frames.append(frame)

    def wait_for(self, count: int) -> list[Frame]:
        assert self.connection is not None
        end_s = time.monotonic() + PATIENCE_S
        while len(self.frames) < count:
            assert time.monotonic() < end_s
            self.connection.read_waiting(time.monotonic_ns())
            time.sleep(0.005)
        return self.frames


@pytest.fixture
def channel():
    return f"connection-{uuid.uuid4()}"


@pytest.fixture
def received():
    return Received()


@pytest.fixture
def connection(channel, received):
    settings = BusSettings("virtual", channel)
    connection = BusConnection(settings, [0x1808D0F4, 0x0008A7D0], received)
    received.connection = connection
    connection.open()
    connection.start_sending()
    yield connection
    connection.close()


@pytest.fixture
def other(channel, connection):
    with can.Bus(interface="virtual", channel=channel) as bus:
        yield bus


def test_a_frame_of_ours_arrives_with_a_monotonic_stamp(connection, other, received):
    before_ns = time.monotonic_ns()
    other.send(can.Message(arbitration_id=0x1808D0F4, data=bytes(range(8))))
    (frame,) = received.wait_for(1)
    assert (frame.can_id, bytes(frame.data)) == (0x1808D0F4, bytes(range(8)))
    assert frame.extended
    assert (frame.remote, frame.error, frame.own_echo) == (False, False, False)
    # The virtual bus stamps with the wall clock, whose float has a resolution of 0.2 us.
    assert before_ns - 1_000_000 <= frame.arrival_ns <= time.monotonic_ns()
    assert frame.arrival_ns % 1_000 == 0


def test_a_frame_waits_until_the_connection_is_read(connection, other, received):
    other.send(can.Message(arbitration_id=0x1808D0F4, data=bytes(8)))
    time.sleep(0.2)  # the Notifier's thread has it
    assert received.frames == []
    assert connection.read_waiting(time.monotonic_ns()) == 1
    assert connection.read_waiting(time.monotonic_ns()) == 0
    assert len(received.frames) == 1


def test_only_our_identifiers_pass_the_filters_at_any_priority(connection, other, received):
    for can_id in (0x18FECA15, 0x0808D0F4, 0x1808D0F5, 0x1808D0F4):
        other.send(can.Message(arbitration_id=can_id, data=bytes(8)))
    other.send(can.Message(arbitration_id=0x0F4, is_extended_id=False, data=bytes(8)))
    other.send(can.Message(arbitration_id=0x0008A7D0, data=bytes(8)))
    frames = received.wait_for(3)
    assert [frame.can_id for frame in frames] == [0x0808D0F4, 0x1808D0F4, 0x0008A7D0]


def test_the_filters_mask_the_priority_out_and_demand_the_extended_flag():
    assert kernel_filters([0x1808D0F4, 0x0808D0F4]) == [
        {"can_id": 0x0008D0F4, "can_mask": 0x03FFFFFF, "extended": True}
    ]


def test_a_group_passes_the_filters_whoever_sends_and_takes_its_messages_filters_place():
    assert kernel_filters([0x1808D0F4, 0x0008A7D0], [0x0008A700, 0x0008FF00]) == [
        {"can_id": 0x0008A700, "can_mask": 0x03FFFF00, "extended": True},
        {"can_id": 0x0008D0F4, "can_mask": 0x03FFFFFF, "extended": True},
        {"can_id": 0x0008FF00, "can_mask": 0x03FFFF00, "extended": True},
    ]


def test_a_sent_frame_is_on_the_bus_and_comes_back_as_our_own_echo(connection, other, received):
    assert connection.send(COMMAND)
    seen = other.recv(PATIENCE_S)
    assert (seen.arbitration_id, bytes(seen.data), seen.is_extended_id) == (
        COMMAND.can_id,
        COMMAND.data,
        True,
    )
    (frame,) = received.wait_for(1)
    assert frame.own_echo
    assert connection.counters.sent == 1


def test_the_same_frame_of_another_node_is_no_echo(connection, other, received):
    other.send(can.Message(arbitration_id=COMMAND.can_id, data=COMMAND.data))
    (frame,) = received.wait_for(1)
    assert not frame.own_echo


def test_sending_on_a_closed_connection_is_refused_and_counted(connection):
    connection.close()
    assert not connection.send(COMMAND)
    assert not connection.is_open
    assert connection.counters.refused == {"closed": 1}
    connection.close()  # a second time does nothing


def test_a_connection_can_be_opened_again(connection, other, received):
    connection.close()
    connection.open()
    assert connection.is_open
    other.send(can.Message(arbitration_id=0x1808D0F4, data=bytes(8)))
    received.wait_for(1)


def test_a_bug_in_the_receiver_costs_its_frame_and_nothing_else(channel):
    received, bugs = Received(), [RuntimeError("bug"), None]

    def receive(frame: Frame) -> None:
        if error := bugs.pop(0):
            raise error
        received(frame)

    connection = BusConnection(BusSettings("virtual", channel), [0x1808D0F4], receive)
    received.connection = connection
    connection.open()
    with can.Bus(interface="virtual", channel=channel) as other:
        for _ in range(2):
            other.send(can.Message(arbitration_id=0x1808D0F4, data=bytes(8)))
        received.wait_for(1)
    assert connection.is_open
    assert (connection.counters.received, connection.counters.receiver_bugs) == (2, 1)
    assert connection.counters.last_bug == "RuntimeError('bug')"
    connection.close()


def test_nothing_is_sent_before_the_ticking_thread_starts_sending(connection, other, received):
    connection.open()
    assert not connection.send(COMMAND)
    assert connection.counters.refused == {"closed": 1}
    other.send(can.Message(arbitration_id=0x1808D0F4, data=bytes(8)))
    received.wait_for(1)  # but it receives
    connection.start_sending()
    assert connection.send(COMMAND)


class BrokenBus(can.BusABC):
    """Fails as told when read, and never sends."""

    channel_info = "broken"

    def __init__(self, error: Exception) -> None:
        super().__init__("broken")
        self._error = error
        self.reads = 0

    def _recv_internal(self, timeout):
        self.reads += 1
        raise self._error

    def send(self, msg, timeout=None):
        raise can.CanOperationError("Transmit buffer full")


def test_a_failed_bus_is_reported_as_lost_and_nothing_is_raised(connection, monkeypatch):
    told = threading.Semaphore(0)
    connection.on_lost = told.release
    failure = can.CanOperationError("Failed to receive: Network is down", 100)
    monkeypatch.setattr(
        "vcu_gateway.bus.connection.open_bus", lambda *_: PlainBus(BrokenBus(failure))
    )
    connection.open()
    assert told.acquire(timeout=PATIENCE_S)
    assert connection.lost == "Failed to receive: Network is down [Error Code 100]"
    connection.start_sending()
    assert not connection.send(COMMAND)
    connection.close()
    assert not told.acquire(blocking=False), "told once, however often the reader failed"


def test_what_the_reader_of_an_earlier_opening_says_does_not_count(connection):
    listener = connection._listener(PlainBus(BrokenBus(OSError())))
    listener.on_error(can.CanOperationError("Failed to receive: Network is down", 100))
    assert connection.is_open


def test_a_full_queue_without_an_errno_is_counted_as_one_with(connection, channel, monkeypatch):
    monkeypatch.setattr(connection, "_sending_bus", PlainBus(BrokenBus(OSError())))
    assert not connection.send(COMMAND)
    assert connection.counters.refused == {"ENOBUFS": 1}
    assert quickest_ns(lambda: connection.send(COMMAND)) < 5_000_000


@pytest.mark.parametrize(
    ("number", "name", "lost"),
    [
        (errno.ENOBUFS, "ENOBUFS", False),
        (errno.EAGAIN, "ENOBUFS", False),  # our own share of the queue is full
        (errno.EINVAL, "EINVAL", False),
        (9999, "9999", False),
        # The kernel tells it once, and may tell it to the sender alone.
        (errno.ENETDOWN, "ENETDOWN", True),
        (errno.ENODEV, "ENODEV", True),
        (errno.ENXIO, "ENXIO", True),
    ],
)
def test_a_frame_that_is_not_taken_is_counted_by_its_errno_and_may_tell_of_a_loss(
    connection, monkeypatch, number, name, lost
):
    refusing = BrokenBus(OSError())
    monkeypatch.setattr(refusing, "send", lambda message: refuse(OSError(number, "no")))
    monkeypatch.setattr(connection, "_sending_bus", PlainBus(refusing))
    assert not connection.send(COMMAND)
    assert connection.counters.refused == {name: 1}
    assert connection.is_open is not lost


def refuse(error: Exception) -> None:
    raise error


def test_sending_never_waits_for_a_connection_that_is_being_closed(connection):
    with connection._send_lock:
        assert not connection.send(COMMAND)
        assert connection.counters.refused == {"closed": 1}
        assert quickest_ns(lambda: connection.send(COMMAND)) < 5_000_000
    assert connection.send(COMMAND)


def test_an_interface_that_is_not_there_is_explained_with_what_to_do(received):
    connection = BusConnection(BusSettings("socketcan", "nocan9"), [0x1808D0F4], received)
    with pytest.raises(UnavailableError, match="cannot open socketcan nocan9") as caught:
        connection.open()
    (problem,) = caught.value.problems
    assert problem.remedy.startswith(("this kernel has no CAN", "for a bench: ip link add"))
    assert not connection.is_open


def test_the_report_has_every_counter_as_plain_data(connection):
    connection.send(COMMAND)
    report = connection.report()
    assert report["sent"] == 1
    assert set(report) == {
        "received", "sent", "refused", "receiver_bugs", "last_bug", "dropped", "lost",
        "repeated_errors", "undecodable",
    }  # fmt: skip
