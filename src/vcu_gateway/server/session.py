"""One connection: what came in, what waits to go out, and when it has to end."""

import select
import socket
from typing import NamedTuple

from vcu_gateway.api.errors import RequestError
from vcu_gateway.server.jsonrpc import RequestId
from vcu_gateway.server.lines import LineBuffer
from vcu_gateway.server.rate_limit import TokenBucket
from vcu_gateway.server.service import Caller
from vcu_gateway.server.subscriptions import SubscriptionState
from vcu_gateway.units import NS_PER_S

_CHUNK_BYTES = 16_384

LINE_TOO_LONG = "line too long"
LINE_LATE = "line not finished in time"
OUTPUT_FULL = "too much output waits"
OUTPUT_STUCK = "reader stands still"
GAVE_WAY = "gave way to a new connection"


class ReplyTo(NamedTuple):
    """To whom an answer goes.

    Attributes:
        id: of the request; None where it had no good one.
        wrong: what was wrong with a request that is done all the same.
    """

    id: RequestId | None
    wrong: RequestError | None = None


class Limits(NamedTuple):
    """What clients may cost.

    Attributes:
        kept_places: of `clients`, for peers that may do more than read.
        metrics_clients: connections to the metrics port.
        rate_per_s: requests of one connection; `burst` of them at once.
        patience_ns: for a line to end, and for a waiting reader to read on.
        unanswered: requests of one connection that wait for their answer.
        pause_ns: without accepting, after the system had nothing left for one more.
        linger_ns: for what is pending at the end.
    """

    clients: int = 16
    kept_places: int = 4
    metrics_clients: int = 4
    accepts_per_s: int = 100
    rate_per_s: int = 200
    burst: int = 50
    unanswered: int = 16
    output_bytes: int = 262_144
    patience_ns: int = 10 * NS_PER_S
    pause_ns: int = NS_PER_S
    linger_ns: int = 300_000_000


DEFAULT_LIMITS = Limits()


class Session:
    """A non-blocking stream socket with its buffers; it decides nothing about requests.

    Attributes:
        caller: None on the metrics port.
        unanswered: addressee of each request without an answer, by our own number of it; None
            where it was a notification.
        head: the lines of an HTTP request so far; None while it speaks JSON.
        peer_ended: the peer sends no more; `peer_is_gone`: nor does it read.
        is_told: the service knows of that.
        drives: it has made a demand; it is served between all the others.
        waited: the next request was held up by the rate.
        is_new: no line was taken yet.
        active_ns: when it came, last asked for something, or was last sent something.
    """

    def __init__(
        self, sock: socket.socket, caller: Caller | None, limits: Limits, now_ns: int
    ) -> None:
        self.sock = sock
        self.caller = caller
        self.lines = LineBuffer()
        self.pace = TokenBucket(limits.rate_per_s, limits.burst, now_ns)
        self.unanswered: dict[int, ReplyTo | None] = {}
        self.subscriptions: dict[int, SubscriptionState] = {}
        self.head: list[bytes] | None = [] if caller is None else None
        self.peer_ended = self.peer_is_gone = self.is_told = False
        self.waited = self.drives = False
        self.is_new = True
        self.active_ns = now_ns
        self._limits = limits
        self._out = bytearray()
        self._is_read_to_end = False
        self._end_reason: str | None = None
        self._began_ns = now_ns
        self._progress_ns = now_ns

    @property
    def has_output(self) -> bool:
        """True while the peer has to read before anything goes on."""
        return bool(self._out)

    @property
    def is_ending(self) -> bool:
        """True once it ends as soon as its output is out."""
        return self._end_reason is not None

    @property
    def live_subscriptions(self) -> list[SubscriptionState]:
        """Those that go on: none of a connection that ends."""
        return [] if self.is_ending or self.peer_ended else [*self.subscriptions.values()]

    @property
    def has_request(self) -> bool:
        """True where a line waits that the connection's limits on the answers let through."""
        return self.lines.has_line and self._takes_requests

    @property
    def wants_bytes(self) -> bool:
        """True where there is room for more to be read."""
        return self._takes_requests and not self._is_read_to_end and not self.lines.has_line

    @property
    def _takes_requests(self) -> bool:
        room = len(self.unanswered) < self._limits.unanswered
        return room and not self._out and not self.is_ending

    @property
    def events(self) -> int:
        """What to wait for, as epoll has it; nothing of a peer that is gone."""
        if self.peer_is_gone:
            return 0
        events = select.EPOLLOUT if self._out else 0
        if not self.peer_ended:
            # Its end is seen even while nothing is read: a demand must not outlive it.
            events |= select.EPOLLRDHUP | (select.EPOLLIN if self.wants_bytes else 0)
        return events

    def receive(self, now_ns: int) -> None:
        """Read one chunk, or learn that nothing more comes."""
        if not self.lines.is_partial:
            self._begin(now_ns)
        chunk = self._receive_chunk()
        if chunk:
            self.lines.feed(chunk)
        elif chunk is not None:
            self.lines.end()
            self._is_read_to_end = self.peer_ended = True

    def _receive_chunk(self) -> bytes | None:
        """Empty at the end; None where nothing is there yet."""
        try:
            return self.sock.recv(_CHUNK_BYTES)
        except BlockingIOError:
            return b"" if self.peer_ended else None
        except OSError:
            self.lose()
            return b""

    def take_line(self, now_ns: int) -> bytes:
        """The next line; the one behind it begins now."""
        self.active_ns = now_ns
        self._begin(now_ns)
        return self.lines.take()

    def _begin(self, now_ns: int) -> None:
        """The time for a line begins to run; that for an HTTP head runs from its first line."""
        if self.head is None:
            self._began_ns = now_ns

    def answered(self, number: int, now_ns: int) -> ReplyTo | None:
        """Forget this request; None for a notification or one that is forgotten."""
        if len(self.unanswered) == self._limits.unanswered:
            self._begin(now_ns)  # nothing was read meanwhile
        return self.unanswered.pop(number, None)

    def send(self, data: bytes, now_ns: int) -> None:
        """Send now, or keep what the peer has no room for."""
        if self.peer_is_gone:
            return
        self.active_ns = now_ns
        if not self._out:
            self._progress_ns = now_ns
        self._out += data
        self.flush(now_ns)

    def flush(self, now_ns: int) -> None:
        """Send what waits, as far as there is room."""
        try:
            sent = self.sock.send(self._out, socket.MSG_NOSIGNAL)
        except BlockingIOError:
            return
        except OSError:
            self.lose()
            return
        del self._out[:sent]
        self._progress_ns = now_ns
        self._begin(now_ns)

    def end_after_output(self, reason: str) -> None:
        """Read nothing more; end when the output is out. An empty reason is an ordinary end."""
        self._end_reason = reason

    def lose(self) -> None:
        """The peer reads no more: what waits for it is dropped."""
        self.peer_ended = self.peer_is_gone = True
        self._out.clear()

    def verdict(self, now_ns: int) -> str | None:
        """Why it has to end now, empty where all is done; None where it goes on."""
        if self._out:
            return self._verdict_on_output(now_ns)
        if self._end_reason is not None:
            return self._end_reason
        if self._is_late(now_ns):
            return LINE_LATE
        return "" if self._is_done(now_ns) else None

    def next_ns(self, now_ns: int) -> int | None:
        """When something has to be done without the peer; None where nothing has."""
        times_ns = [subscription.due_ns for subscription in self.live_subscriptions]
        if self._out:
            times_ns.append(self._progress_ns + self._limits.patience_ns)
        elif self.has_request:
            times_ns.append(self.pace.ready_ns)
        elif self.peer_ended and self.wants_bytes:
            times_ns.append(now_ns)  # epoll tells nothing more of it
        elif self._is_expected:
            times_ns.append(self._began_ns + self._limits.patience_ns)
        return min(times_ns, default=None)

    def _is_done(self, now_ns: int) -> bool:
        if self.peer_is_gone and self._has_to_wait(now_ns):
            return True  # nobody would read the answers
        is_answered = self.peer_is_gone or not self.unanswered
        return self._is_read_to_end and not self.lines.has_line and is_answered

    def _has_to_wait(self, now_ns: int) -> bool:
        is_held_up = self.lines.has_line and now_ns < self.pace.ready_ns
        return is_held_up or not self._takes_requests

    def _verdict_on_output(self, now_ns: int) -> str | None:
        if len(self._out) > self._limits.output_bytes:
            return OUTPUT_FULL
        is_stuck = now_ns - self._progress_ns >= self._limits.patience_ns
        return OUTPUT_STUCK if is_stuck else None

    def _is_late(self, now_ns: int) -> bool:
        return self._is_expected and now_ns - self._began_ns >= self._limits.patience_ns

    @property
    def _is_expected(self) -> bool:
        """True while the peer owes the rest of a line, or of a head."""
        return self.wants_bytes and (self.lines.is_partial or self.head is not None)
