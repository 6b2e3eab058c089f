"""SocketCAN as it is read here, with a datagram socket in place of a CAN socket."""

import socket
import struct
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from typing import Any

import can
import pytest
from can.interfaces.socketcan import socketcan as library

from vcu_gateway.bus.connection import BusConnection, BusSettings
from vcu_gateway.bus.reader import DrainedBus, FrameListener
from vcu_gateway.bus.settings import BusCounters
from vcu_gateway.bus.socketcan import DrainingSocketcanBus
from vcu_gateway.core.j1939 import Frame

EFF, ERR = 0x8000_0000, 0x2000_0000
BMS_STATUS = 0x1808D0F4
BATCH_FRAMES = 256
PATIENCE_S = 30.0
SO_MEMINFO, SO_TIMESTAMPNS = 55, 35
S = 1_000_000_000


class StandIn(socket.socket):
    """Forgives the options that only CAN has.

    Attributes:
        drops: the kernel's count of frames for which it had no room; CAN has one, this kind waits.
    """

    drops = 0

    def setsockopt(self, level: int, *rest: Any) -> None:
        if level != socket.SOL_CAN_RAW:
            super().setsockopt(level, *rest)

    def getsockopt(self, level: int, option: int, *length: int) -> Any:
        if option == SO_MEMINFO:
            return struct.pack("@9I", *[0] * 8, self.drops)
        return super().getsockopt(level, option, *length)


class Wire:
    """A bus, its reader, and the far end of its socket.

    Attributes:
        frames: received so far; lost: reasons that were reported.
        on_frame: called with each frame, after it was taken.
    """

    def __init__(self, near: socket.socket, far: socket.socket) -> None:
        self.far, self.near = far, near
        self.counters = BusCounters()
        self.frames: list[Frame] = []
        self.lost: list[str] = []
        self.on_frame: Callable[[Frame], object] = lambda frame: None
        self.bus = DrainingSocketcanBus("can0", None, None, self.counters)
        listener = FrameListener(self.receive, self.counters, self.lost.append, True)
        self.reader = DrainedBus(self.bus)
        self.reader.start(listener)

    def receive(self, frame: Frame) -> None:
        self.frames.append(frame)
        self.on_frame(frame)

    def send(self, can_id: int = EFF | BMS_STATUS, data: bytes = bytes(8)) -> None:
        self.far.send(struct.pack("=IB3x8s", can_id, len(data), data))

    def send_numbered(self, first: int, count: int) -> None:
        for number in range(first, first + count):
            self.send(data=number.to_bytes(8, "little"))

    def read(self) -> int:
        return self.reader.read_waiting(time.monotonic_ns())

    def break_off(self) -> None:
        """The socket reports a failure once, as that of an interface that went down does."""
        self.bus.send_now(BMS_STATUS, bytes(8))  # else nothing is lost by it
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as other:
            other.bind(f"\0{uuid.uuid4()}")
            self.far.connect(other.getsockname())

    def close(self) -> None:
        if not self.bus._is_shutdown:
            self.reader.close()

    @property
    def numbers(self) -> list[int]:
        return [int.from_bytes(frame.data, "little") for frame in self.frames]


@pytest.fixture
def ends(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[socket.socket, socket.socket]]:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    far.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 212_992)
    far.setblocking(False)
    with near, far:
        monkeypatch.setattr(StandIn, "drops", 0)
        monkeypatch.setattr(library, "create_socket", lambda: StandIn(fileno=near.detach()))
        monkeypatch.setattr(library, "bind_socket", lambda *_: None)
        yield near, far


@pytest.fixture
def wire(ends: tuple[socket.socket, socket.socket]) -> Iterator[Wire]:
    one = Wire(*ends)
    yield one
    one.close()


def test_frames_wait_until_they_are_read_and_come_in_order_as_old_as_they_are(wire: Wire):
    before_ns = time.monotonic_ns()
    wire.send_numbered(0, 20)
    sent_ns = time.monotonic_ns()
    assert wire.frames == []
    time.sleep(0.05)
    assert wire.read() == 20
    assert wire.numbers == list(range(20))
    leeway_ns = 100_000  # both clocks are read one after the other
    arrivals_ns = [frame.arrival_ns for frame in wire.frames]
    assert before_ns - leeway_ns <= min(arrivals_ns)
    assert max(arrivals_ns) <= sent_ns + leeway_ns
    assert {(f.can_id, f.extended, f.error, f.own_echo) for f in wire.frames} == {
        (BMS_STATUS, True, False, False)
    }


def test_a_stamp_is_in_whole_microseconds_and_never_younger_than_the_frame(wire: Wire):
    for _ in range(20):
        wire.send()
        wire.read()
        read_ns = time.monotonic_ns()
        assert wire.frames[-1].arrival_ns % 1_000 == 0
        assert wire.frames[-1].arrival_ns <= read_ns


def test_reading_an_empty_socket_takes_no_time(wire: Wire):
    assert wire.read() == 0
    assert wire.reader.drains == 1


def test_more_than_a_batch_is_read_at_once(wire: Wire):
    wire.send_numbered(0, BATCH_FRAMES + 100)
    assert wire.read() == BATCH_FRAMES + 100
    assert wire.numbers == list(range(BATCH_FRAMES + 100))
    assert wire.reader.drains == 1


def test_what_comes_faster_than_it_is_read_is_left_to_the_next_time(wire: Wire):
    wire.on_frame = lambda frame: wire.send()
    wire.send_numbered(0, BATCH_FRAMES)
    assert BATCH_FRAMES < wire.read() <= 2 * BATCH_FRAMES
    assert wire.reader.drains == 1
    wire.on_frame = lambda frame: None
    assert wire.read() >= BATCH_FRAMES


def test_every_frame_of_the_wire_counts_though_a_repeated_error_is_handed_on_once(wire: Wire):
    for _ in range(50):
        wire.send(ERR | 0x088)
    assert wire.read() == 50
    assert len(wire.frames) == 1
    assert wire.counters.repeated_errors == 49
    wire.send(ERR | 0x088)
    wire.read()
    assert len(wire.frames) == 2, "one in each reading, so that a state that lasts is heard of"


def test_a_bug_in_the_receiver_costs_its_frame_and_nothing_else(wire: Wire):
    wire.on_frame = lambda frame: 1 // int(frame.data[0] != 1)
    wire.send_numbered(0, 3)
    wire.read()
    assert wire.numbers == [0, 1, 2]
    assert (wire.counters.receiver_bugs, wire.lost) == (1, [])


def test_a_failed_interface_is_reported_once_and_its_socket_not_read_again(wire: Wire):
    wire.break_off()
    wire.read()
    assert wire.lost == ["Failed to receive: Connection reset by peer [Error Code 104]"]
    for _ in range(5):
        wire.read()
    assert len(wire.lost) == 1
    assert wire.bus.recv(0) is None


def test_a_python_can_notifier_that_was_stopped_reads_no_more(wire: Wire):
    wire.send()
    wire.reader._notifier.stop()
    assert wire.read() == 0
    assert (wire.frames, wire.reader.drains) == ([], 0), "the watchdog sees that it stands still"


def test_what_was_never_read_is_counted_as_dropped(wire: Wire):
    wire.send_numbered(0, 3)
    wire.reader.close()
    assert (wire.counters.received, wire.counters.dropped) == (0, 3)
    assert wire.read() == 0


def test_dropped_frames_are_counted_at_once_where_many_frames_waited(wire: Wire):
    wire.read()
    StandIn.drops = 7
    wire.send_numbered(0, 138)
    wire.read()
    assert wire.counters.dropped == 0
    wire.send_numbered(0, 139)
    wire.read()
    assert wire.counters.dropped == 7


def test_dropped_frames_of_a_small_buffer_are_counted_within_a_second(wire: Wire):
    now_ns = time.monotonic_ns()
    wire.reader.read_waiting(now_ns)
    StandIn.drops = 0xFFFF_FFFF
    wire.reader.read_waiting(now_ns + S - 1)
    assert wire.counters.dropped == 0
    wire.reader.read_waiting(now_ns + S)
    assert wire.counters.dropped == 0xFFFF_FFFF
    StandIn.drops = 1  # it has 32 bits
    wire.reader.read_waiting(now_ns + 2 * S)
    assert wire.counters.dropped == 0xFFFF_FFFF + 2


def test_a_frame_without_a_stamp_is_as_old_as_the_reading_before_and_the_next_has_one(wire: Wire):
    wire.send()
    wire.read()
    earlier_ns = time.monotonic_ns()
    wire.bus.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 0)
    wire.send()
    wire.read()
    wire.bus.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    time.sleep(0.005)
    later_ns = time.monotonic_ns()
    wire.send()
    wire.read()
    assert wire.frames[1].arrival_ns <= earlier_ns
    assert wire.frames[2].arrival_ns >= later_ns - 100_000


def test_nobody_waits_to_read_what_another_thread_reads_or_closes(wire: Wire):
    may_go_on, is_reading = threading.Event(), threading.Event()

    def hold_up(frame: Frame) -> None:
        is_reading.set()
        assert may_go_on.wait(PATIENCE_S)

    wire.on_frame = hold_up
    wire.send_numbered(0, 2)
    reading = threading.Thread(target=wire.read)
    closing = threading.Thread(target=wire.reader.close)
    reading.start()
    assert is_reading.wait(PATIENCE_S)
    closing.start()
    assert wire.read() == 0
    assert not wire.bus._is_shutdown
    may_go_on.set()
    reading.join(PATIENCE_S)
    closing.join(PATIENCE_S)
    assert wire.numbers == [0, 1]
    assert wire.bus._is_shutdown


@pytest.mark.parametrize(("asked_bytes", "given_bytes"), [(50_000, 50_000), (None, 212_992)])
def test_the_receive_buffer_is_as_large_as_asked_or_as_the_kernel_grants(
    ends: tuple[socket.socket, socket.socket], asked_bytes: int | None, given_bytes: int
):
    bus = DrainingSocketcanBus("can0", None, asked_bytes, BusCounters())
    assert bus.receive_buffer_bytes >= given_bytes
    assert asked_bytes is None or bus.receive_buffer_bytes == asked_bytes
    bus.shutdown()


# The connection above it.


@pytest.fixture
def connection(
    ends: tuple[socket.socket, socket.socket], received: list[Frame]
) -> Iterator[BusConnection]:
    connection = BusConnection(BusSettings("socketcan", "can0"), [BMS_STATUS], received.append)
    connection.open()
    yield connection
    connection.close()


@pytest.fixture
def received() -> list[Frame]:
    return []


def test_what_came_before_a_loss_is_read_before_the_connection_is_closed(
    connection: BusConnection, ends: tuple[socket.socket, socket.socket], received: list[Frame]
):
    ends[1].send(struct.pack("=IB3x8s", EFF | BMS_STATUS, 8, bytes(8)))
    connection.mark_lost("can0 is down")

    def close() -> None:
        connection.wait_until_read(PATIENCE_S)
        connection.close()

    closing = threading.Thread(target=close)
    closing.start()
    closing.join(0.05)
    assert closing.is_alive(), "it waits for the ticking thread"
    assert connection.read_waiting(time.monotonic_ns()) == 1
    closing.join(PATIENCE_S)
    assert len(received) == 1
    assert connection.counters.dropped == 0


def is_waited_for(connection: BusConnection) -> bool:
    begun_s = time.monotonic()
    connection.wait_until_read(0.05)
    return time.monotonic() - begun_s >= 0.05


def test_a_reading_that_began_before_the_loss_is_not_enough(
    ends: tuple[socket.socket, socket.socket],
):
    def lose(frame: Frame) -> None:
        one.mark_lost("can0 is down")

    one = BusConnection(BusSettings("socketcan", "can0"), [BMS_STATUS], lose)
    one.open()
    ends[1].send(struct.pack("=IB3x8s", EFF | BMS_STATUS, 8, bytes(8)))
    assert one.read_waiting(time.monotonic_ns()) == 1
    assert is_waited_for(one)
    one.read_waiting(time.monotonic_ns())
    assert not is_waited_for(one)
    one.close()


def test_a_reading_since_an_earlier_loss_is_not_enough(connection: BusConnection):
    connection.mark_lost("can0 is down")
    connection.read_waiting(time.monotonic_ns())
    connection.lost = None  # as another opening does
    connection.mark_lost("can0 is down again")
    assert is_waited_for(connection)


def test_reads_are_counted_while_it_is_open(connection: BusConnection):
    connection.read_waiting(time.monotonic_ns())
    assert connection.drains == 1
    connection.mark_lost("can0 is down")
    assert connection.drains is None


def test_no_thread_is_started(connection: BusConnection):
    assert not [thread for thread in threading.enumerate() if "Notifier" in thread.name]


def test_it_is_python_cans_notifier_that_receives(connection: BusConnection):
    bus = connection._bus
    assert isinstance(bus, DrainedBus)
    assert len(can.Notifier.find_instances(bus._library_bus)) == 1
