"""Frames handed on by a reader, and by the ticking thread in between."""

import threading
import time
from collections.abc import Iterator

import can
import pytest

from vcu_gateway.bus.frame_queue import FrameQueue

PATIENCE_S = 30.0


def messages(*numbers: int) -> list[can.Message]:
    return [can.Message(arbitration_id=number) for number in numbers]


class Reader:
    """Takes frames as python-can's Notifier does; it may be held up with one in its hands."""

    def __init__(self, queue: FrameQueue) -> None:
        self.handed_on: list[int] = []
        self.has_one, self.may_go_on = threading.Event(), threading.Event()
        self._queue, self._ended = queue, False
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        while not self._ended:
            if (message := self._queue.take()) is not None:
                self.has_one.set()
                self.may_go_on.wait(PATIENCE_S)
                self.handed_on.append(message.arbitration_id)

    def end(self) -> None:
        self._ended = True
        self.may_go_on.set()
        self._thread.join(PATIENCE_S)


@pytest.fixture
def queue() -> FrameQueue:
    return FrameQueue()


@pytest.fixture
def reader(queue: FrameQueue) -> Iterator[Reader]:
    reader = Reader(queue)
    yield reader
    reader.end()


def nothing_more() -> bool:
    return False


def test_what_is_pending_comes_before_what_is_read_now(queue: FrameQueue):
    handed_on: list[int] = []
    waiting = [messages(3, 4), messages(5)]

    def read_more() -> bool:
        if waiting:
            queue.pending.extend(waiting.pop(0))
            return True
        return False

    queue.pending.extend(messages(1, 2))
    assert queue.empty(lambda message: handed_on.append(message.arbitration_id), read_more)
    assert handed_on == [1, 2, 3, 4, 5]
    assert queue.take() is None


def test_what_was_read_before_a_failure_is_handed_on_and_the_failure_raised(queue: FrameQueue):
    handed_on: list[int] = []

    def fail() -> bool:
        queue.pending.extend(messages(1))
        raise OSError("the interface is down")

    with pytest.raises(OSError, match="down"):
        queue.empty(lambda message: handed_on.append(message.arbitration_id), fail)
    assert handed_on == [1]
    queue.pending.extend(messages(2))
    assert queue.take() is not None, "the reader goes on"


def test_the_frame_in_the_readers_hands_is_waited_for_and_comes_first(
    queue: FrameQueue, reader: Reader
):
    seen: list[list[int]] = []
    queue.pending.extend(messages(1, 2))
    assert reader.has_one.wait(PATIENCE_S)
    threading.Timer(0.001, reader.may_go_on.set).start()
    while not queue.empty(lambda message: seen.append([*reader.handed_on]), nothing_more):
        pass  # the machine stalled
    # The reader may have got the second one, too; whatever the tick had came after all of it.
    assert seen in ([[1]], [])
    assert reader.handed_on[0] == 1


def test_a_reader_that_is_held_up_is_waited_for_some_milliseconds_only(
    queue: FrameQueue, reader: Reader
):
    handed_on: list[can.Message] = []
    queue.pending.extend(messages(1, 2))
    assert reader.has_one.wait(PATIENCE_S)
    took_s = []
    for _ in range(3):
        begun_s = time.monotonic()
        assert not queue.empty(handed_on.append, nothing_more)
        took_s.append(time.monotonic() - begun_s)
    assert 0.014 < min(took_s) < 0.1
    assert handed_on == [], "never both at the same time"
    reader.may_go_on.set()
    while reader.handed_on != [1, 2]:
        time.sleep(0.001)


class Handed:
    """What was handed on, by whichever thread; never by two at once."""

    def __init__(self) -> None:
        self.numbers: list[int] = []
        self._entered = threading.Lock()

    def __call__(self, message: can.Message) -> None:
        assert self._entered.acquire(blocking=False), "two threads at once"
        self.numbers.append(message.arbitration_id)
        self._entered.release()

    def read(self, queue: FrameQueue, count: int) -> None:
        while len(self.numbers) < count:
            if (message := queue.take()) is not None:
                self(message)


def fill(queue: FrameQueue, count: int) -> None:
    for first in range(0, count, 100):
        with queue.lock:
            queue.pending.extend(messages(*range(first, first + 100)))
        time.sleep(0)


def test_with_both_at_work_every_frame_is_handed_on_once_and_in_order(queue: FrameQueue):
    count, by_tick, handed = 20_000, 0, Handed()
    works = [(handed.read, (queue, count)), (fill, (queue, count))]
    threads = [threading.Thread(target=work, args=told, daemon=True) for work, told in works]
    for thread in threads:
        thread.start()
    while len(handed.numbers) < count:
        before = len(handed.numbers)
        queue.empty(handed, nothing_more)
        by_tick += len(handed.numbers) - before
        time.sleep(0.0005)
    for thread in threads:
        thread.join(PATIENCE_S)
    assert handed.numbers == list(range(count))
    assert by_tick > 0
