"""Link watch: waiting until a network interface may have changed, or somebody wakes the waiter."""

import contextlib
import os
import select
import socket

from vcu_gateway.bus import netlink

_NOTICE_BYTES = 4096


class LinkWatch:
    """Waits for rtnetlink's notices of links, for other input, a wake-up or a time-out.

    A notice says only that it is time to look; whatever it says of which interface is not read.
    The kernel reports lost notices as an error, which is as good as a notice.

    It waits for the time alone before it is opened.

    Attributes:
        is_told: False where the kernel refuses notices: one has to look from time to time.
    """

    def __init__(self) -> None:
        self.is_told = False
        self._poll = select.poll()
        self._wakeup: int | None = None
        self._notices: socket.socket | None = None

    def open(self) -> None:
        """Subscribe to notices, and take wake-ups from now on."""
        self._wakeup = os.eventfd(0, os.EFD_CLOEXEC | os.EFD_NONBLOCK)
        self.watch(self._wakeup)
        with contextlib.suppress(OSError):
            self._notices = netlink.subscribe()
            self.watch(self._notices.fileno())
            self.is_told = True

    def watch(self, descriptor: int) -> None:
        """Let input on this descriptor end a wait, too."""
        self._poll.register(descriptor, select.POLLIN)

    def wake(self) -> None:
        """End the wait, or the next one; from any thread."""
        if (wakeup := self._wakeup) is not None:
            os.eventfd_write(wakeup, 1)

    def wait(self, at_most_s: float) -> None:
        """Wait until there may be something to look at, or this time is over."""
        self._poll.poll(at_most_s * 1000)
        with contextlib.suppress(BlockingIOError):
            if self._wakeup is not None:
                os.eventfd_read(self._wakeup)
        with contextlib.suppress(OSError):  # none is left, or some were lost
            while self._notices is not None:
                self._notices.recv(_NOTICE_BYTES)

    def close(self) -> None:
        """Give the descriptors back; nobody waits any more."""
        wakeup, self._wakeup = self._wakeup, None
        if wakeup is not None:
            os.close(wakeup)
        if self._notices is not None:
            self._notices.close()
