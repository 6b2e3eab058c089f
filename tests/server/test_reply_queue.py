"""Reply queue: replies from any thread, at the price of one system call."""

import gc
import os
import threading

import pytest

from vcu_gateway.server.service import QueuedReply, ReplyQueue


@pytest.fixture
def queue():
    return ReplyQueue()


def taken(queue):
    return [queue.queued.popleft() for _ in range(len(queue.queued))]


def test_replies_come_out_in_their_order(queue):
    queue.put(1, 2, {})
    queue.put(1, 3, {"a": 1})
    assert taken(queue) == [QueuedReply(1, 2, {}), QueuedReply(1, 3, {"a": 1})]
    assert taken(queue) == []


def test_the_descriptor_is_written_once_until_it_is_cleared(queue):
    with pytest.raises(BlockingIOError):
        os.eventfd_read(queue.fd)
    for number in range(5):
        queue.put(1, number, {})
    assert os.eventfd_read(queue.fd) == 1
    queue.wake()
    with pytest.raises(BlockingIOError):
        queue.clear_wakeup()  # not cleared yet: it was not written again


def test_once_cleared_the_descriptor_is_written_again(queue):
    queue.put(1, 1, {})
    queue.clear_wakeup()
    queue.put(1, 2, {})
    queue.clear_wakeup()
    assert len(taken(queue)) == 2


def test_a_closed_queue_keeps_nothing(queue):
    queue.put(1, 1, {})
    queue.close()
    queue.put(1, 2, {})
    assert taken(queue) == []


def test_its_descriptor_is_closed_with_the_last_producer():
    queue = ReplyQueue()
    put, fd = queue.put, queue.fd
    del queue
    put(1, 1, {})
    assert os.eventfd_read(fd) == 1
    del put
    gc.collect()
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.eventfd_read(fd)


def test_no_reply_is_lost_between_threads(queue):
    count, numbers = 20_000, []

    def write() -> None:
        for number in range(count):
            queue.put(0, number, {})

    writer = threading.Thread(target=write)
    os.set_blocking(queue.fd, True)
    writer.start()
    while len(numbers) < count:
        queue.clear_wakeup()
        numbers.extend(reply.number for reply in taken(queue))
    writer.join()
    assert numbers == list(range(count))
