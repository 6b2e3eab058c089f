"""The bus door on python-can's virtual bus: frames in, frames out, failures told once."""

import errno
import threading
import time
import uuid
from collections.abc import Callable

import can
import pytest

from vcu_gateway.bus.connection import BusConnection, BusSettings, kernel_filters
from vcu_gateway.core.frame import Frame
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


class Inbox:
    """Collects frames and wakes whoever waits for a number of them."""

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self._changed = threading.Condition()

    def __call__(self, frame: Frame) -> None:
        with self._changed:
            self.frames.append(frame)
            self._changed.notify_all()

    def wait_for(self, count: int) -> list[Frame]:
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.frames) >= count, PATIENCE_S)
        return self.frames


@pytest.fixture
def channel():
    return f"door-{uuid.uuid4()}"


@pytest.fixture
def inbox():
    return Inbox()


@pytest.fixture
def door(channel, inbox):
    settings = BusSettings("virtual", channel)
    door = BusConnection(settings, [0x1808D0F4, 0x0008A7D0], inbox)
    door.open()
    door.admit()
    yield door
    door.close()


@pytest.fixture
def other(channel, door):
    with can.Bus(interface="virtual", channel=channel) as bus:
        yield bus


def test_a_frame_of_ours_arrives_with_a_monotonic_stamp(door, other, inbox):
    before_ns = time.monotonic_ns()
    other.send(can.Message(arbitration_id=0x1808D0F4, data=bytes(range(8))))
    (frame,) = inbox.wait_for(1)
    assert (frame.can_id, bytes(frame.data)) == (0x1808D0F4, bytes(range(8)))
    assert frame.extended
    assert (frame.remote, frame.error, frame.own_echo) == (False, False, False)
    # The virtual bus stamps with the wall clock, whose float has a resolution of 0.2 us.
    assert before_ns - 1_000_000 <= frame.arrival_ns <= time.monotonic_ns()


def test_only_our_identifiers_pass_the_filters_at_any_priority(door, other, inbox):
    for can_id in (0x18FECA15, 0x0808D0F4, 0x1808D0F5, 0x1808D0F4):
        other.send(can.Message(arbitration_id=can_id, data=bytes(8)))
    other.send(can.Message(arbitration_id=0x0F4, is_extended_id=False, data=bytes(8)))
    other.send(can.Message(arbitration_id=0x0008A7D0, data=bytes(8)))
    frames = inbox.wait_for(3)
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


def test_a_sent_frame_is_on_the_bus_and_comes_back_as_our_own_echo(door, other, inbox):
    assert door.send(COMMAND)
    seen = other.recv(PATIENCE_S)
    assert (seen.arbitration_id, bytes(seen.data), seen.is_extended_id) == (
        COMMAND.can_id,
        COMMAND.data,
        True,
    )
    (frame,) = inbox.wait_for(1)
    assert frame.own_echo
    assert door.counters.sent == 1


def test_the_same_frame_of_another_node_is_no_echo(door, other, inbox):
    other.send(can.Message(arbitration_id=COMMAND.can_id, data=COMMAND.data))
    (frame,) = inbox.wait_for(1)
    assert not frame.own_echo


def test_sending_on_a_closed_door_is_refused_and_counted(door):
    door.close()
    assert not door.send(COMMAND)
    assert not door.is_open
    assert door.counters.refused == {"closed": 1}
    door.close()  # a second time does nothing


def test_a_door_can_be_opened_again(door, other, inbox):
    door.close()
    door.open()
    assert door.is_open
    other.send(can.Message(arbitration_id=0x1808D0F4, data=bytes(8)))
    inbox.wait_for(1)


def test_a_bug_in_the_receiver_costs_its_frame_and_nothing_else(channel):
    inbox, bugs = Inbox(), [RuntimeError("bug"), None]

    def receive(frame: Frame) -> None:
        if error := bugs.pop(0):
            raise error
        inbox(frame)

    door = BusConnection(BusSettings("virtual", channel), [0x1808D0F4], receive)
    door.open()
    with can.Bus(interface="virtual", channel=channel) as other:
        for _ in range(2):
            other.send(can.Message(arbitration_id=0x1808D0F4, data=bytes(8)))
        inbox.wait_for(1)
    assert door.is_open
    assert (door.counters.received, door.counters.receiver_bugs) == (2, 1)
    assert door.counters.last_bug == "RuntimeError('bug')"
    door.close()


def test_nothing_is_sent_on_a_door_that_the_ticking_thread_has_not_admitted(door, other, inbox):
    door.open()
    assert not door.send(COMMAND)
    assert door.counters.refused == {"closed": 1}
    other.send(can.Message(arbitration_id=0x1808D0F4, data=bytes(8)))
    inbox.wait_for(1)  # but it receives
    door.admit()
    assert door.send(COMMAND)


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


def test_a_failed_bus_is_told_as_lost_and_nothing_is_raised(door, monkeypatch):
    told = threading.Semaphore(0)
    door.on_lost = told.release
    failure = can.CanOperationError("Failed to receive: Network is down", 100)
    monkeypatch.setattr(door, "_open_bus", lambda: BrokenBus(failure))
    door.open()
    assert told.acquire(timeout=PATIENCE_S)
    assert door.lost == "Failed to receive: Network is down [Error Code 100]"
    door.admit()
    assert not door.send(COMMAND)
    door.close()
    assert not told.acquire(blocking=False), "told once, however often the reader failed"


def test_what_the_reader_of_an_earlier_opening_says_does_not_count(door):
    listener = door._listener(BrokenBus(OSError()))
    listener.on_error(can.CanOperationError("Failed to receive: Network is down", 100))
    assert door.is_open


def test_a_full_queue_without_an_errno_is_counted_as_one_with(door, channel, monkeypatch):
    monkeypatch.setattr(door, "_admitted", BrokenBus(OSError()))
    assert not door.send(COMMAND)
    assert door.counters.refused == {"ENOBUFS": 1}
    assert quickest_ns(lambda: door.send(COMMAND)) < 5_000_000


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
    door, monkeypatch, number, name, lost
):
    refusing = BrokenBus(OSError())
    monkeypatch.setattr(refusing, "send", lambda message: refuse(OSError(number, "no")))
    monkeypatch.setattr(door, "_admitted", refusing)
    assert not door.send(COMMAND)
    assert door.counters.refused == {name: 1}
    assert door.is_open is not lost


def refuse(error: Exception) -> None:
    raise error


def test_sending_never_waits_for_a_door_that_is_being_closed(door):
    with door._sending:
        assert not door.send(COMMAND)
        assert door.counters.refused == {"closed": 1}
        assert quickest_ns(lambda: door.send(COMMAND)) < 5_000_000
    assert door.send(COMMAND)


def test_an_interface_that_is_not_there_is_explained_with_what_to_do(inbox):
    door = BusConnection(BusSettings("socketcan", "nocan9"), [0x1808D0F4], inbox)
    with pytest.raises(UnavailableError, match="cannot open socketcan nocan9") as caught:
        door.open()
    (problem,) = caught.value.problems
    assert problem.remedy.startswith(("this kernel has no CAN", "for a bench: ip link add"))
    assert not door.is_open


def test_the_report_has_every_counter_as_plain_data(door):
    door.send(COMMAND)
    report = door.report()
    assert report["sent"] == 1
    assert set(report) == {
        "received", "sent", "refused", "receiver_bugs", "last_bug", "dropped", "lost",
        "repeated_errors", "reader_not_awaited", "undecodable",
    }  # fmt: skip
