"""The kernel's notices of links, of a real interface."""

import threading
import time
from collections.abc import Callable

import pytest

from tests.vcan.conftest import ip
from vcu_gateway.bus.netlink import LinkWatch

LONG_S = 30.0


def down() -> None:
    ip("link", "set", "vcan9", "down")


def renamed() -> None:
    down()
    ip("link", "set", "vcan9", "name", "vcan10")
    ip("link", "set", "vcan10", "name", "vcan9")


def deleted() -> None:
    ip("link", "del", "vcan9")
    ip("link", "add", "dev", "vcan9", "type", "vcan")


@pytest.mark.parametrize("change", [down, renamed, deleted])
def test_a_change_of_a_link_ends_the_wait(change: Callable[[], None]):
    ip("link", "add", "dev", "vcan9", "type", "vcan")
    watch = LinkWatch()
    try:
        ip("link", "set", "vcan9", "up")
        watch.open()
        assert watch.is_told
        watch.wait(0.2)
        changing = threading.Timer(0.1, change)
        changing.start()
        begun_s = time.monotonic()
        watch.wait(LONG_S)
        assert time.monotonic() - begun_s < LONG_S / 2
        changing.join()
    finally:
        watch.close()
        ip("link", "del", "vcan9")
