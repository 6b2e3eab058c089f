"""Replies on their way from any thread to the API's thread."""

import os
import weakref
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.server.service import Reply


class QueuedReply(NamedTuple):
    """A reply to the request `number` of the connection `connection`."""

    connection: int
    number: int
    reply: Reply


class ReplyQueue:
    """A queue and a descriptor that becomes readable; putting costs one system call at most.

    The ticking thread puts replies in, so there is no lock that it could wait for.
    """

    def __init__(self) -> None:
        self._letters: deque[QueuedReply] = deque()
        self._is_rung = False
        self._is_shut = False
        self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        # Closed only when nobody can ring any more: its number may belong to the bus by then.
        weakref.finalize(self, os.close, self.fd)

    def put(self, connection: int, number: int, reply: Reply) -> None:
        """Hand over a reply; from any thread, at any time."""
        if not self._is_shut:
            self._letters.append(QueuedReply(connection, number, reply))
            self.ring()

    def ring(self) -> None:
        """Wake the API's thread."""
        if not self._is_rung:
            self._is_rung = True
            os.eventfd_write(self.fd, 1)

    def hush(self) -> None:
        """After the descriptor was readable, and before `take`: what comes then rings again."""
        os.eventfd_read(self.fd)
        self._is_rung = False

    def take(self) -> Iterator[QueuedReply]:
        """Everything that waits; only the API's thread takes."""
        while self._letters:
            yield self._letters.popleft()

    def shut(self) -> None:
        """Take nothing more, and forget what is there."""
        self._is_shut = True
        self._letters.clear()
