"""Queue of replies from any thread to the API's thread."""

import os
import weakref
from collections import deque
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.server.service import Reply


class QueuedReply(NamedTuple):
    """Reply to the request `number` of the connection `connection`."""

    connection: int
    number: int
    reply: Reply


class ReplyQueue:
    """Queue with a descriptor that becomes readable; `put` costs one system call at most.

    The ticking thread puts replies in, so there is no lock that it could wait for.
    """

    def __init__(self) -> None:
        self._replies: deque[QueuedReply] = deque()
        self._is_woken = False
        self._is_closed = False
        self.fd = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        # Closed only when no producer is left: its number may belong to the bus by then.
        weakref.finalize(self, os.close, self.fd)

    def put(self, connection: int, number: int, reply: Reply) -> None:
        """Append a reply and wake the API's thread; from any thread, at any time."""
        if not self._is_closed:
            self._replies.append(QueuedReply(connection, number, reply))
            self.wake()

    def wake(self) -> None:
        if not self._is_woken:
            self._is_woken = True
            os.eventfd_write(self.fd, 1)

    def clear_wakeup(self) -> None:
        """Reset the descriptor, before `take`: a reply put later makes it readable again."""
        os.eventfd_read(self.fd)
        self._is_woken = False

    def take(self) -> Iterator[QueuedReply]:
        """All queued replies, the oldest first; on the API's thread only."""
        while self._replies:
            yield self._replies.popleft()

    def close(self) -> None:
        """Drop the queued replies and all that are put later."""
        self._is_closed = True
        self._replies.clear()
