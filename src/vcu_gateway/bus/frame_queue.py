"""Queue of read frames, handed on by the reader or at once by the ticking thread.

The reader takes them one by one. Right before a tick the ticking thread takes the rest over. Both
never hand on at the same time, and the order of arrival is kept.
"""

import threading
import time
from collections import deque
from collections.abc import Callable

from vcu_gateway.python_can import can
from vcu_gateway.units import NS_PER_S

# The reader needs some microseconds for the frame that it holds, and gets them while the ticking
# thread sleeps; frames of a tick may leave until 25 ms after it.
_PATIENCE_NS = 15_000_000
_GIVE_WAY_S = 0.000_05


class FrameQueue:
    """A queue with one reader, which another thread may empty in between.

    Attributes:
        lock: held while frames are put in.
        pending: frames in the order of their arrival.
        with_reader: the reader holds one; until it takes it, a frame is in `pending`.
    """

    def __init__(self) -> None:
        self.lock = threading.Lock()
        self.pending: deque[can.Message] = deque()
        self.with_reader = False
        self._wanted = False

    def take(self) -> can.Message | None:
        """The reader's next frame, None where nothing waits; it is done with the one before."""
        self.with_reader = False
        while self._wanted:
            time.sleep(_GIVE_WAY_S)
        with self.lock:
            self.with_reader = bool(self.pending)
            return self.pending.popleft() if self.with_reader else None

    def empty(self, hand_on: Callable[[can.Message], None], read_more: Callable[[], bool]) -> bool:
        """Hand on all that is pending, then what `read_more` puts in, until it returns False.

        Waits at most 15 ms for the reader; False, and nothing was handed on, where that was too
        short. `hand_on` must not raise; what `read_more` raises is raised when all that was
        pending has been handed on.
        """
        self._wanted = True
        try:
            if not self._reader_is_done():
                return False
            try:
                self._hand_on_all(hand_on, read_more)
            finally:
                self.lock.release()
        finally:
            self._wanted = False
        return True

    def _reader_is_done(self) -> bool:
        """Take the lock while the reader holds no frame; False where that took too long."""
        end_ns = time.monotonic_ns() + _PATIENCE_NS
        while (left_ns := end_ns - time.monotonic_ns()) > 0:
            if self.lock.acquire(timeout=left_ns / NS_PER_S):
                if not self.with_reader:
                    return True
                self.lock.release()
                time.sleep(_GIVE_WAY_S)
        return False

    def _hand_on_all(
        self, hand_on: Callable[[can.Message], None], read_more: Callable[[], bool]
    ) -> None:
        def hand_on_pending() -> None:
            while self.pending:
                hand_on(self.pending.popleft())

        hand_on_pending()
        try:
            while read_more():
                hand_on_pending()
        finally:
            hand_on_pending()
