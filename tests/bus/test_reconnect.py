"""The reconnector, look by look, with a scripted clock, interface and connection."""

import itertools
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any, cast

import pytest

from vcu_gateway.bus.connection import BusConnection, BusSettings
from vcu_gateway.bus.interface import Interface
from vcu_gateway.bus.netlink import InterfaceDetails
from vcu_gateway.bus.reconnect import CarrierChanged, LinkLost, LinkOpened, Reconnector, Unavailable
from vcu_gateway.errors import Problem, UnavailableError

MS = 1_000_000
PATIENCE_S = 30.0
UP = Interface(number=3, is_can=True, up=True, carrier=True, tx_queue_frames=4)
DOWN = UP._replace(up=False, carrier=False)


class FakeLock:
    """Counts how often it answered."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self.answers = 0

    def answer(self) -> None:
        self.answers += 1


class FakeConnection:
    """Opens when it is told to, and counts."""

    def __init__(self) -> None:
        self.settings = BusSettings("socketcan", "can0")
        self.instance_lock: FakeLock | None = None
        self.receive_buffer_bytes = 212_992
        self.lost: str | None = "not opened yet"
        self.refusal: str | None = None
        self.openings = self.closings = 0
        self.steps: list[str] = []
        self.on_lost = lambda: None

    @property
    def is_open(self) -> bool:
        return self.lost is None

    def open(self) -> None:
        self.openings += 1
        if self.refusal is not None:
            raise UnavailableError(Problem(self.refusal))
        self.lost = None

    def mark_lost(self, why: str) -> None:
        self.lost = self.lost or why

    def wait_until_read(self, patience_s: float) -> None:
        self.steps.append(f"read within {patience_s} s")

    def close(self) -> None:
        self.closings += 1
        self.steps.append("close")


class LookRig:
    """A reconnector that looks every 100 ms of simulated time at what the test puts there.

    Attributes:
        looks: so far, also those of its thread where it was started.
    """

    def __init__(self) -> None:
        self.now_ns = 1_000 * MS
        self.looks = 0
        self.connection = FakeConnection()
        self.found: Interface | None = UP
        self.names = {3: "can0"}
        self.reconnector = Reconnector(
            cast(BusConnection, self.connection),
            200,
            look=self._look,
            name_of=self.names.get,
            details=lambda channel: InterfaceDetails(),
        )

    def _look(self) -> Interface | None:
        self.looks += 1
        return self.found

    def look(self, times: int = 1) -> list[Any]:
        """The changes that this many looks found."""
        for _ in range(times):
            self.reconnector.step(self.now_ns)
            self.now_ns += 100 * MS
        changes = list(self.reconnector.changes)
        self.reconnector.changes.clear()
        return changes


@pytest.fixture
def rig() -> LookRig:
    return LookRig()


@pytest.fixture
def steady(rig: LookRig) -> LookRig:
    """Open for longer than it takes to count as steady."""
    (opened,) = rig.look()
    assert isinstance(opened, LinkOpened)
    rig.look(60)
    return rig


def kinds(changes: list[object]) -> list[type]:
    return [type(one) for one in changes]


def test_an_interface_that_is_there_is_opened_at_once(rig: LookRig):
    (opened,) = rig.look()
    assert (opened.interface, opened.receive_buffer_bytes) == (UP, 212_992)
    assert rig.look(100) == [], "and then left alone"
    assert rig.connection.openings == 1


@pytest.mark.parametrize(
    ("found", "sentence"),
    [
        (None, "cannot open socketcan can0: no such interface; "),
        (DOWN, "can0 is down; ip link set can0 up"),
        (
            UP._replace(is_can=False),
            "cannot open socketcan can0: it is no CAN interface; bus.channel must be one of: ip ",
        ),
    ],
)
def test_an_interface_that_cannot_be_used_is_reported_once_and_waited_for(rig, found, sentence):
    rig.found = found
    (unavailable,) = rig.look(50)
    assert unavailable.why.startswith(sentence)
    assert rig.connection.lost == unavailable.why
    assert rig.connection.openings == 0, "nothing is tried in vain"
    rig.found = UP
    assert kinds(rig.look()) == [LinkOpened]


@pytest.mark.parametrize(
    ("found", "names", "why"),
    [
        (DOWN, {3: "can0"}, "can0 is down"),
        (None, {}, "can0 is gone"),
        (None, {3: "can7"}, "can0 was renamed to can7"),
        (UP._replace(number=9), {9: "can0"}, "can0 is gone"),  # made again under its name
        (UP._replace(number=9), {3: "can1", 9: "can0"}, "can0 was renamed to can1"),
    ],
)
def test_an_interface_that_changes_under_us_is_lost_even_if_the_socket_is_silent(
    steady, found, names, why
):
    steady.found = found
    steady.names.clear()
    steady.names.update(names)
    changes = steady.look()
    assert changes[0] == LinkLost(steady.now_ns - 100 * MS, why)
    assert steady.connection.closings == 1
    is_there_again = found is not None and found.up
    assert kinds(changes[1:]) == [LinkOpened if is_there_again else Unavailable]


def test_what_came_before_a_loss_may_be_read_before_the_interface_is_closed(steady: LookRig):
    steady.found = DOWN
    steady.look()
    assert steady.connection.steps == ["read within 0.2 s", "close"]


def test_an_interface_that_is_down_and_then_renamed_is_reported_with_its_new_name(
    steady: LookRig,
):
    steady.found = DOWN
    assert kinds(steady.look()) == [LinkLost, Unavailable]
    steady.found = None
    steady.names[3] = "can7"
    sentence = "can0 was renamed to can7; rename it back, or set bus.channel to can7"
    assert steady.look(5) == [Unavailable(sentence)]
    steady.names.clear()
    (gone,) = steady.look(5)
    assert "no such interface" in gone.why


def test_what_the_reader_reported_is_the_reason_where_the_interface_looks_well(
    steady: LookRig,
):
    steady.connection.mark_lost("Failed to receive: Network is down")
    lost, opened = steady.look()
    assert lost.why == "Failed to receive: Network is down"
    assert isinstance(opened, LinkOpened), "at once: it was steady"


def test_a_link_that_comes_back_is_opened_at_the_next_look(steady: LookRig):
    steady.found = None
    steady.look(300)
    steady.found = UP._replace(number=4)
    assert kinds(steady.look()) == [LinkOpened]


def test_a_flickering_link_is_opened_with_growing_pauses_and_always_within_a_second(
    rig: LookRig,
):
    opened_ns = []
    for _ in range(400):
        opened_ns += [rig.now_ns for one in rig.look() if isinstance(one, LinkOpened)]
        rig.connection.mark_lost("flickers")
    pauses_ms = [(b - a) // MS for a, b in itertools.pairwise(opened_ns)]
    assert pauses_ms[:4] == [200, 400, 800, 800]
    assert set(pauses_ms[2:]) == {800}


def test_after_a_steady_time_the_pauses_begin_anew(rig: LookRig):
    rig.look()
    for _ in range(50):
        rig.connection.mark_lost("flickers")
        rig.look()
    rig.look(8)
    rig.look(50)
    rig.connection.mark_lost("once")
    assert kinds(rig.look()) == [LinkLost, LinkOpened]
    rig.connection.mark_lost("twice")
    assert kinds(rig.look(3)) == [LinkLost, LinkOpened], "after 200 ms, no longer after 800"


def test_an_opening_that_fails_is_reported_once_for_each_reason_and_tried_again(
    rig: LookRig,
):
    rig.connection.refusal = "no file descriptors"
    assert rig.look(30) == [Unavailable("no file descriptors")]
    assert 3 <= rig.connection.openings <= 6, "with pauses"
    rig.connection.refusal = "no memory"
    assert rig.look(30) == [Unavailable("no memory")]
    rig.connection.refusal = None
    assert kinds(rig.look(8)) == [LinkOpened]


def test_the_carrier_is_reported_when_it_changes_and_never_as_there_before_it_was(
    steady: LookRig,
):
    steady.found, gone_ns = UP._replace(carrier=False), steady.now_ns
    assert steady.look(5) == [CarrierChanged(gone_ns, False)]
    steady.found, still_gone_ns = UP, steady.now_ns - 100 * MS
    assert steady.look(5) == [CarrierChanged(still_gone_ns, True)]
    assert steady.connection.openings == 1


def test_the_carrier_at_the_opening_is_the_better_of_both_words(rig: LookRig):
    rig.found = UP._replace(carrier=False)  # the flag follows up to a second later
    rig.reconnector._details = lambda channel: InterfaceDetails(carrier=True)
    (opened,) = rig.look()
    assert opened.carrier
    rig.reconnector._details = lambda channel: InterfaceDetails()
    assert not opened._replace(details=InterfaceDetails()).carrier


# The thread.


@pytest.fixture
def running(rig: LookRig) -> Iterator[LookRig]:
    """Its thread has looked for the first time."""
    rig.reconnector.start()
    assert rig.reconnector.tried.wait(PATIENCE_S)
    yield rig
    rig.reconnector.stop()


def looks_within(running: LookRig, duration_s: float) -> int:
    before = running.looks
    time.sleep(duration_s)
    return running.looks - before


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.005)


def test_an_interface_in_use_is_left_alone_until_the_kernel_tells_of_a_change(running: LookRig):
    is_left_alone = any(looks_within(running, 0.5) <= 1 for _ in range(4))
    assert is_left_alone, "links of this machine change while it is tested, but not always"


@pytest.mark.parametrize("found", [None, DOWN, UP._replace(carrier=False)])
def test_an_interface_that_cannot_be_used_is_looked_at_ten_times_a_second(running, found):
    running.found = found
    running.connection.on_lost()
    assert any(looks_within(running, 1.0) >= 5 for _ in range(5))


def test_a_loss_that_a_reader_reports_is_looked_at_at_once(running: LookRig):
    openings = running.connection.openings
    running.connection.mark_lost("Failed to receive: Network is down")
    running.connection.on_lost()
    until(lambda: running.connection.openings > openings)


def test_whoever_asks_for_the_locks_holder_is_answered_at_once(rig: LookRig):
    near, far = socket.socketpair()
    lock = rig.connection.instance_lock = FakeLock(near.fileno())
    with near, far:
        rig.reconnector.start()
        assert rig.reconnector.tried.wait(PATIENCE_S)
        far.send(b"?")  # nobody reads it: it is there again and again
        assert any(looks_within(rig, 0.5) >= 5 for _ in range(5))
        assert lock.answers >= 5
        rig.reconnector.stop()
