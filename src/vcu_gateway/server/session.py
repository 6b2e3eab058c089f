"""Session of one connection: buffers, pending requests, subscriptions and timeouts.

Line buffer: received bytes, cut into lines, from which a stop is taken before its turn.
"""

import fcntl
import select
import socket
import struct
import termios
from dataclasses import dataclass
from typing import NamedTuple

from vcu_gateway.api.errors import RequestError
from vcu_gateway.rate_limit import TokenBucket
from vcu_gateway.server.jsonrpc import MARKS, RequestId
from vcu_gateway.server.service import Caller, SessionLimits
from vcu_gateway.units import NS_PER_S

MAX_LINE_BYTES = 65_536
"""Longest line, without its newline."""


class LineBuffer:
    """Received bytes, cut into lines of bounded length, from which a stop is taken first.

    A stop leaves the lines that wait then, or wait unread in the socket, overtaken.

    Attributes:
        has_line: a whole line of permitted length can be taken.
        is_too_long: the next line exceeds the length; it stays so.
    """

    def __init__(self) -> None:
        self.has_line = self.is_too_long = False
        self._buffer = bytearray()
        self._searched_bytes = 0
        self._newline_at = -1
        self._whole_bytes = 0
        self._marks_from = 0
        self._marked = range(0)
        self._overtaken_bytes = 0

    def __len__(self) -> int:
        return len(self._buffer)

    @property
    def is_partial(self) -> bool:
        """True while a line has begun and not ended."""
        return self._newline_at < 0 and bool(self._buffer)

    @property
    def is_overtaken(self) -> bool:
        """True where a stop has passed over the next line."""
        return self._overtaken_bytes > 0

    def overtake(self, unread_bytes: int) -> None:
        """Mark all that waits, and so many bytes that are not read yet."""
        self._overtaken_bytes = len(self._buffer) + unread_bytes

    def feed(self, chunk: bytes) -> None:
        newline_at = chunk.rfind(b"\n")
        if newline_at >= 0:
            self._whole_bytes = len(self._buffer) + newline_at + 1
        self._buffer += chunk
        self._search()

    def end(self) -> None:
        """End the stream: buffered bytes are the last line."""
        if len(self._buffer) > self._whole_bytes:
            self.feed(b"\n")

    def take(self) -> bytes:
        """Remove and return the next line without its newline; only while `has_line`."""
        return self._take(range(self._newline_at))

    def next_marked(self) -> bytes | None:
        """The next whole line that may name a stop, each once; None where none is left."""
        buffer, begin, end = self._buffer, self._marks_from, self._whole_bytes
        places = [at for mark in MARKS if (at := buffer.find(mark, begin, end)) >= 0]
        if not places:
            self._marks_from = end
            return None
        begin = buffer.rfind(b"\n", 0, min(places)) + 1
        self._marked = range(begin, buffer.find(b"\n", min(places)))
        self._marks_from = self._marked.stop + 1
        return bytes(buffer[begin : self._marked.stop])

    def take_marked(self) -> None:
        """Remove the line that `next_marked` returned last, before anything else is taken."""
        self._take(self._marked)

    def _take(self, place: range) -> bytes:
        line, taken = bytes(self._buffer[place.start : place.stop]), len(place) + 1
        del self._buffer[place.start : place.stop + 1]
        self._whole_bytes -= taken
        self._marks_from = max(0, self._marks_from - taken)
        self._overtaken_bytes = max(0, self._overtaken_bytes - taken)
        if place.start == 0:
            self._newline_at, self._searched_bytes = -1, 0
            self._search()
        return line

    def _search(self) -> None:
        if self._newline_at < 0:
            self._newline_at = self._buffer.find(b"\n", self._searched_bytes)
            self._searched_bytes = len(self._buffer)
        end = self._newline_at if self._newline_at >= 0 else len(self._buffer)
        self.is_too_long = end > MAX_LINE_BYTES
        self.has_line = self._newline_at >= 0 and not self.is_too_long


MAX_WAITING_BYTES = 262_144
"""Requests that wait are read up to here, and one chunk more: a stop among them is found."""

_UNSEATED_BYTES = 16_384
_CHUNK_BYTES = 65_536
_INT = struct.Struct("i")

LINE_TOO_LONG = "line too long"
LINE_LATE = "line not finished in time"
OUTPUT_FULL = "too much output waits"
OUTPUT_STUCK = "reader stands still"
EVICTED = "gave way to a new connection"


class ReplyTo(NamedTuple):
    """Addressee of a reply.

    Attributes:
        id: of the request; None where it had no valid one.
        error: of a malformed request that is carried out all the same.
    """

    id: RequestId | None
    error: RequestError | None = None


@dataclass(slots=True)
class SubscriptionState:
    """Subscription with updates on the grid origin_ns + n * period; the first at once.

    Attributes:
        messages: names of the messages to send; None for all.
        due_ns: due time of the next update.
        lost: updates left out since the last one, because the reader was slow.
    """

    number: int
    messages: list[str] | None
    rate_hz: float
    due_ns: int
    lost: int = 0

    def advance(self, now_ns: int) -> int:
        """Advance to the first point of the grid after `now_ns`; returns the points passed."""
        period_ns = round(NS_PER_S / self.rate_hz)
        points = (now_ns - self.due_ns) // period_ns + 1
        self.due_ns += points * period_ns
        return points


class SessionDue(NamedTuple):
    """What is due of a session.

    Attributes:
        close_reason: why to close it now, empty for an ordinary end; None where it goes on.
        events: to wait for, as epoll has them.
        next_check_ns: time of the next check without an event; None where only events matter.
    """

    close_reason: str | None
    events: int = 0
    next_check_ns: int | None = None


class Session:
    """Non-blocking stream socket with its buffers; requests are the `RequestHandler`'s.

    Attributes:
        rate: token bucket of its requests.
        pending: addressee of each request without a reply, by our own number of it; None
            where it was a notification.
        peer_ended: the peer sends no more; `peer_is_lost`: nor does it read.
        has_ended_demands: the service was asked to end its demands.
        is_driver: it has made a demand; it is served between all the others.
        is_seated: it has a place; until then only a stop of it is served.
        is_ending: a line was too long; nothing more is read, and it is closed after its output.
        active_ns: time of the connection, of its last request or of the last output to it.
    """

    def __init__(
        self, sock: socket.socket, caller: Caller, limits: SessionLimits, now_ns: int
    ) -> None:
        self.sock = sock
        self.caller = caller
        self.lines = LineBuffer()
        self.rate = TokenBucket(NS_PER_S // limits.rate_per_s, limits.burst, now_ns)
        self.pending: dict[int, ReplyTo | None] = {}
        self.subscriptions: dict[int, SubscriptionState] = {}
        self.peer_ended = self.peer_is_lost = self.has_ended_demands = False
        self.is_driver = self.is_seated = self.is_ending = False
        self.active_ns = now_ns
        self._limits = limits
        self._output = bytearray()
        self._is_read_to_end = False
        self._waits_since_ns = now_ns
        self._progress_ns = now_ns

    @property
    def has_output(self) -> bool:
        return bool(self._output)

    @property
    def live_subscriptions(self) -> list[SubscriptionState]:
        """Subscriptions to send updates of; none of a connection that ends."""
        return [] if self.is_ending or self.peer_ended else [*self.subscriptions.values()]

    @property
    def _wants_input(self) -> bool:
        """True where more is to be read: also behind what waits, for a stop may be there."""
        is_full = len(self.lines) >= (MAX_WAITING_BYTES if self.is_seated else _UNSEATED_BYTES)
        return not (self._is_read_to_end or self.is_ending or is_full)

    @property
    def _takes_requests(self) -> bool:
        has_capacity = len(self.pending) < self._limits.pending_requests
        return has_capacity and not self._output and not self.is_ending

    @property
    def _events(self) -> int:
        """Events to wait for, as epoll has them; none of a peer that is lost."""
        if self.peer_is_lost:
            return 0
        events = select.EPOLLOUT if self._output else 0
        if not self.peer_ended:
            # The end of the peer is seen even while nothing is read: a demand must not outlive it.
            events |= select.EPOLLRDHUP | (select.EPOLLIN if self._wants_input else 0)
        return events

    def receive(self, now_ns: int) -> bool:
        """Read one chunk, or the end of the stream, where it may be; True: more may have come."""
        if not self._wants_input:
            return False
        if not self.lines.is_partial:
            self._waits_since_ns = now_ns
        chunk = self._receive_chunk()
        if chunk:
            self.lines.feed(chunk)
        elif chunk is not None:
            self.lines.end()
            self._is_read_to_end = self.peer_ended = True
        return chunk is not None and len(chunk) == _CHUNK_BYTES

    def overtake(self) -> None:
        """Mark every request that waits here or in the socket as overtaken by a stop."""
        self.lines.overtake(_unread_bytes(self.sock))

    def _receive_chunk(self) -> bytes | None:
        """Chunk read; empty at the end, None where nothing has arrived."""
        try:
            return self.sock.recv(_CHUNK_BYTES)
        except BlockingIOError:
            return b"" if self.peer_ended else None
        except OSError:
            self.mark_lost()
            return b""

    def next_marked(self) -> bytes | None:
        """As the line buffer's; None where a stop may not pass over what waits: it came often."""
        if self.is_ending or len(self.pending) >= 2 * self._limits.pending_requests:
            return None
        return self.lines.next_marked()

    def take_line(self, now_ns: int) -> tuple[bytes, bool] | None:
        """Next line, and whether it is overtaken; None where the limits allow none now.

        Only while a line waits; the timeout of the one behind it begins now.
        """
        if not (self._takes_requests and self.rate.taken(now_ns)):
            return None
        self.active_ns = now_ns
        self._waits_since_ns = now_ns
        is_overtaken = self.lines.is_overtaken
        return self.lines.take(), is_overtaken

    def take_pending(self, number: int, now_ns: int) -> ReplyTo | None:
        """Remove a pending request; None for a notification or an unknown number."""
        if len(self.pending) == self._limits.pending_requests:
            self._waits_since_ns = now_ns  # nothing was read meanwhile
        return self.pending.pop(number, None)

    def send(self, data: bytes, now_ns: int) -> None:
        """Send now, and buffer what the kernel does not take."""
        if self.peer_is_lost:
            return
        self.active_ns = now_ns
        if not self._output:
            self._progress_ns = now_ns
        self._output += data
        self.flush(now_ns)

    def flush(self, now_ns: int) -> None:
        try:
            sent = self.sock.send(self._output, socket.MSG_NOSIGNAL)
        except BlockingIOError:
            return
        except OSError:
            self.mark_lost()
            return
        del self._output[:sent]
        self._progress_ns = now_ns
        self._waits_since_ns = now_ns

    def mark_lost(self) -> None:
        """Note that the peer reads no more, and drop its output."""
        self.peer_ended = self.peer_is_lost = True
        self._output.clear()

    def due(self, now_ns: int) -> SessionDue:
        """What the loop has to do with it, and when to ask again."""
        reason = self._close_reason(now_ns)
        if reason is not None:
            return SessionDue(reason)
        return SessionDue(None, self._events, self._next_check_ns(now_ns))

    def _close_reason(self, now_ns: int) -> str | None:
        """Reason to close it now, empty for an ordinary end; None where it goes on."""
        if self._output:
            return self._output_close_reason(now_ns)
        if self.is_ending:
            return LINE_TOO_LONG
        if self._awaits_input and now_ns - self._waits_since_ns >= self._limits.timeout_ns:
            return LINE_LATE
        return "" if self._is_done(now_ns) else None

    def _next_check_ns(self, now_ns: int) -> int | None:
        """Time of the next check without an event; None where only events matter."""
        times_ns = [subscription.due_ns for subscription in self.live_subscriptions]
        if self.peer_ended and self._wants_input:
            times_ns.append(now_ns)  # epoll reports nothing more of it
        if self._output:
            times_ns.append(self._progress_ns + self._limits.timeout_ns)
        elif self.lines.has_line and self._takes_requests:
            times_ns.append(self.rate.ready_ns)
        elif self._awaits_input:
            times_ns.append(self._waits_since_ns + self._limits.timeout_ns)
        return min(times_ns, default=None)

    def _is_done(self, now_ns: int) -> bool:
        if self.peer_is_lost and (not self.is_seated or self._has_to_wait(now_ns)):
            return True  # nobody would read the replies
        has_replied = self.peer_is_lost or not self.pending
        return self._is_read_to_end and not self.lines.has_line and has_replied

    def _has_to_wait(self, now_ns: int) -> bool:
        is_held_up = self.lines.has_line and now_ns < self.rate.ready_ns
        return is_held_up or not self._takes_requests

    def _output_close_reason(self, now_ns: int) -> str | None:
        if len(self._output) > self._limits.output_bytes:
            return OUTPUT_FULL
        is_stuck = now_ns - self._progress_ns >= self._limits.timeout_ns
        return OUTPUT_STUCK if is_stuck else None

    @property
    def _awaits_input(self) -> bool:
        """True while the peer has to send the rest of a line."""
        is_read = self._takes_requests and not self._is_read_to_end
        return is_read and self.lines.is_partial


def _unread_bytes(sock: socket.socket) -> int:
    try:
        return int(_INT.unpack(fcntl.ioctl(sock, termios.FIONREAD, bytes(_INT.size)))[0])
    except OSError:
        return 0
