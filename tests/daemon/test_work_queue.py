"""Work for the ticking thread: in order, bounded before a tick, and in time for it."""

import functools
import itertools
import os
import signal
import threading
import time
from collections.abc import Iterator

import pytest

from vcu_gateway.daemon.ticking_thread import WorkQueue

monotonic_ns = time.monotonic_ns


def read_then_pause(pauses: Iterator[float]) -> int:
    """The time, with which the reader goes on only after the next of the pauses, in s."""
    now_ns = monotonic_ns()
    time.sleep(next(pauses))  # as where another thread has the processor meanwhile
    return now_ns


def test_work_is_done_in_the_order_of_posting():
    queue, done = WorkQueue(), []
    for number in range(5):
        queue.post(functools.partial(done.append, number))
    queue.run_waiting()
    assert done == [0, 1, 2, 3, 4]


def test_before_a_tick_only_so_much_is_done():
    queue, done = WorkQueue(), []
    for number in range(40):
        queue.post(functools.partial(done.append, number))
    queue.run_waiting()
    assert len(done) == 32
    queue.run_waiting()
    assert len(done) == 40


def test_work_that_work_posts_waits_for_the_next_time():
    queue, done = WorkQueue(), []
    queue.post(lambda: queue.post(lambda: done.append(1)))
    queue.run_waiting()
    assert done == []


def test_where_256_wait_only_what_may_be_refused_is_refused():
    queue, done = WorkQueue(), []
    for _ in range(255):
        queue.post(lambda: None)
    assert queue.offer(lambda: done.append("offered"))
    assert not queue.offer(lambda: done.append("refused"))
    queue.post(lambda: done.append("posted"))
    for _ in range(9):
        queue.run_waiting()
    assert done == ["offered", "posted"]


def test_work_that_comes_in_meanwhile_is_done_at_once():
    queue, done = WorkQueue(), threading.Event()
    threading.Timer(0.02, queue.post, [done.set]).start()
    end_ns = time.monotonic_ns() + 60_000_000_000
    queue.post(lambda: None)
    watcher = threading.Thread(target=queue.run_until, args=(end_ns, end_ns), daemon=True)
    watcher.start()
    assert done.wait(30), "it was left waiting until the end"


def test_without_time_left_nothing_is_waited_for():
    queue, done = WorkQueue(), []
    queue.post(lambda: done.append(1))
    past_ns = time.monotonic_ns() - 1
    queue.run_until(past_ns, past_ns)
    assert done == []


def test_work_that_comes_in_shortly_before_the_end_is_left_to_the_next_time():
    queue, done = WorkQueue(), []
    threading.Timer(0.02, queue.post, [lambda: done.append(1)]).start()
    begun_ns = time.monotonic_ns()
    queue.run_until(begun_ns, begun_ns + 200_000_000)
    assert time.monotonic_ns() - begun_ns >= 200_000_000, "and does not end the waiting"
    assert done == []
    queue.run_waiting()
    assert done == [1]


def test_a_thread_that_is_held_up_as_it_begins_to_wait_wakes_up_in_time(monkeypatch):
    late_ns = []
    for _ in range(20):  # at least once the machine does not hold it up as well
        end_ns = time.monotonic_ns() + 10_000_000
        with monkeypatch.context() as held_up:
            pauses = itertools.chain([0.0018], itertools.repeat(0))
            held_up.setattr(time, "monotonic_ns", functools.partial(read_then_pause, pauses))
            WorkQueue().run_until(end_ns, end_ns)
        late_ns.append(time.monotonic_ns() - end_ns)
    assert 0 <= min(late_ns) < 1_000_000


@pytest.mark.timeout(60)
def test_a_signal_whose_handler_ends_after_the_time_does_not_keep_it():
    """Python's own queues wait for ever then, up to 3.12."""
    before = signal.signal(signal.SIGUSR1, lambda *_: time.sleep(0.3))
    late = threading.Timer(0.1, os.kill, [os.getpid(), signal.SIGUSR1])
    try:
        late.start()
        end_ns = time.monotonic_ns() + 200_000_000
        WorkQueue().run_until(end_ns, end_ns)
    finally:
        late.join()
        signal.signal(signal.SIGUSR1, before)


def test_a_signal_may_post_while_it_is_waited_for():
    queue, done = WorkQueue(), []

    def handler(*_: object) -> None:
        queue.post(lambda: done.append(1))

    before = signal.signal(signal.SIGUSR1, handler)
    try:
        threading.Timer(0.05, os.kill, [os.getpid(), signal.SIGUSR1]).start()
        end_ns = time.monotonic_ns() + 60_000_000_000
        queue.post(lambda: None)
        while not done:
            assert time.monotonic_ns() < end_ns
            soon_ns = time.monotonic_ns() + 1_000_000_000
            queue.run_until(soon_ns, soon_ns)
    finally:
        signal.signal(signal.SIGUSR1, before)
