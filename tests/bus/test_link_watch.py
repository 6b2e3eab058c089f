"""Waiting for a change of a link: woken, told by the kernel, or after the time."""

import os
import socket
import threading
import time
from collections.abc import Iterator

import pytest

from vcu_gateway.bus import netlink
from vcu_gateway.bus.netlink import LinkWatch

LONG_S = 30.0


@pytest.fixture
def watch() -> Iterator[LinkWatch]:
    one = LinkWatch()
    one.open()
    yield one
    one.close()


def waited_s(watch: LinkWatch, at_most_s: float) -> float:
    begun_s = time.monotonic()
    watch.wait(at_most_s)
    return time.monotonic() - begun_s


def test_it_waits_for_its_time_where_nothing_happens(watch: LinkWatch):
    while waited_s(watch, 0.02) < 0.02:
        pass  # a link of the machine changed meanwhile


def test_a_wake_up_ends_the_wait_that_it_came_in_and_no_other(watch: LinkWatch):
    threading.Timer(0.02, watch.wake).start()
    assert waited_s(watch, LONG_S) < LONG_S / 2
    while waited_s(watch, 0.02) < 0.02:
        pass


def test_a_wake_up_before_the_wait_is_not_lost(watch: LinkWatch):
    watch.wake()
    watch.wake()
    assert waited_s(watch, LONG_S) < LONG_S / 2


def test_other_input_ends_the_wait(watch: LinkWatch):
    near, far = socket.socketpair()
    with near, far:
        watch.watch(near.fileno())
        far.send(b"?")
        assert waited_s(watch, LONG_S) < LONG_S / 2


def test_before_it_is_opened_and_after_it_is_closed_a_wake_up_does_nothing():
    watch = LinkWatch()
    watch.wake()
    watch.open()
    watch.close()
    watch.wake()


def test_every_descriptor_is_given_back():
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(10):
        watch = LinkWatch()
        watch.open()
        watch.close()
    assert len(os.listdir("/proc/self/fd")) <= before


def test_without_notices_one_has_to_look(monkeypatch: pytest.MonkeyPatch):
    def refused() -> socket.socket:
        raise OSError("no such protocol")

    monkeypatch.setattr(netlink, "subscribe", refused)
    watch = LinkWatch()
    watch.open()
    assert not watch.is_told
    watch.wake()
    assert waited_s(watch, LONG_S) < LONG_S / 2
    watch.close()
