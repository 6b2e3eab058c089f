"""The API's loop: every connection gets its turn, in the gaps between the ticks."""

import contextlib
import select
import time

from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.server.acceptor import Acceptor, ConnectionCounts, may_only_read
from vcu_gateway.server.counters import Counters
from vcu_gateway.server.http import is_http
from vcu_gateway.server.reply_queue import ReplyQueue
from vcu_gateway.server.request_handler import RequestHandler
from vcu_gateway.server.scraping import Scraping
from vcu_gateway.server.service import Caller, RequestService
from vcu_gateway.server.session import GAVE_WAY, Limits, Session
from vcu_gateway.server.tick_gaps import TickGaps
from vcu_gateway.units import NS_PER_S

_UPDATES_PER_ROUND = 4
_LOOK_S = 0.005


class EventLoop:
    """Connections and listening sockets on the API's thread.

    A round is: what the sockets tell, replies, one request of each connection, a few updates,
    and a look at every connection's time.
    """

    def __init__(
        self,
        service: RequestService,
        gaps: TickGaps,
        limits: Limits,
        receptions: list[Acceptor],
        mailbox: ReplyQueue,
        counters: Counters,
    ) -> None:
        self._service = service
        self._gaps = gaps
        self._limits = limits
        self._receptions = receptions
        self._mailbox = mailbox
        self._counters = counters
        self._desk = RequestHandler(service, counters, mailbox.put)
        self._scraping = Scraping(service, gaps)
        self._connections: dict[int, Session] = {}
        self._watched: dict[int, int] = {}
        self._epoll = select.epoll()
        self._watch(mailbox.fd, select.EPOLLIN)
        self._wake_ns: int | None = time.monotonic_ns()

    def round(self) -> None:
        """Wait for something to do, and do it."""
        events = dict(self._epoll.poll(self._timeout_s()))
        for fd in self._connections.keys() & events.keys():
            self._on_event(self._connections[fd], events[fd])
        for reception in self._receptions:
            if reception.sock.fileno() in events:
                self._accept(reception)
        if self._mailbox.fd in events:
            self._mailbox.hush()
        self._deliver()
        for connection in list(self._connections.values()):
            self._serve_drivers()
            self._serve(connection)
        self._send_updates()
        self._look_at_all()

    def wind_up(self) -> None:
        """Answer what is pending, for a short while; nothing new is read."""
        end_ns = time.monotonic_ns() + self._limits.linger_ns
        while self._is_pending() and time.monotonic_ns() < end_ns:
            time.sleep(_LOOK_S)
            self._deliver()
            for connection in self._connections.values():
                if connection.has_output:
                    connection.flush(self._now_ns())
        ending = RequestError(ErrorCode.NOT_READY, "the gateway is ending")
        for connection in self._connections.values():
            for number in list(connection.unanswered):
                self._desk.answer(connection, number, ending, self._now_ns())

    def close(self) -> None:
        """End every connection, also where the service has a bug at one of them."""
        with self._epoll, contextlib.ExitStack() as ends:
            for connection in list(self._connections.values()):
                ends.callback(self._end, connection, "")

    def _now_ns(self) -> int:
        """The time after room for one unit of work was found."""
        self._gaps.wait()
        return time.monotonic_ns()

    def _timeout_s(self) -> float | None:
        if self._wake_ns is None:
            return None
        return max(0.0, (self._wake_ns - time.monotonic_ns()) / NS_PER_S)

    def _on_event(self, connection: Session, event: int) -> None:
        now_ns = self._now_ns()
        if event & (select.EPOLLHUP | select.EPOLLERR):
            connection.lose()
        if event & select.EPOLLRDHUP:
            connection.peer_ended = True
        self._tell_if_gone(connection)
        if event & select.EPOLLOUT and connection.has_output:
            connection.flush(now_ns)
        if event & select.EPOLLIN:
            self._receive(connection, now_ns)

    def _accept(self, reception: Acceptor) -> None:
        connection = reception.accept(self._guests(), self._make_room, self._now_ns())
        if connection is not None:
            self._connections[connection.sock.fileno()] = connection
            self._counters.clients += connection.caller is not None

    def _guests(self) -> ConnectionCounts:
        callers = [connection.caller for connection in self._connections.values()]
        clients = [caller for caller in callers if caller is not None]
        readers = sum(may_only_read(caller) for caller in clients)
        return ConnectionCounts(len(clients), readers, len(callers) - len(clients))

    def _make_room(self, newcomer: Caller, must_be_readers: bool) -> bool:
        """The longest idle connection without a fresh demand gives way; False without one.

        A user with more than half of the places makes room among its own: a flood of
        connections does not push out those of others.
        """
        clients = [(one.caller, one) for one in self._connections.values() if one.caller]
        own = [(caller, one) for caller, one in clients if caller.peer.uid == newcomer.peer.uid]
        within = own if 2 * len(own) > len(clients) else clients
        for caller, connection in sorted(within, key=lambda pair: pair[1].active_ns):
            fits = not must_be_readers or may_only_read(caller)
            if fits and not self._service.owns_demand(caller):
                self._give_way(connection)
                return True
        return False

    def _give_way(self, connection: Session) -> None:
        """What it asked for before counts: it may be an emergency stop."""
        self._receive(connection, self._now_ns())
        while connection.has_request and time.monotonic_ns() >= connection.pace.ready_ns:
            self._serve(connection)
        self._counters.gave_way += 1
        self._end(connection, GAVE_WAY)

    def _deliver(self) -> None:
        """Send the replies that have come."""
        for letter in self._mailbox.take():
            for connection in self._connections.values():
                caller = connection.caller
                if caller is not None and caller.connection == letter.connection:
                    self._desk.answer(connection, letter.number, letter.reply, self._now_ns())

    def _serve(self, connection: Session) -> None:
        """One request of this connection, where it may have one now."""
        if connection.has_request:
            self._handle_line(connection, self._now_ns())
        elif connection.peer_ended:
            self._receive(connection, self._now_ns())  # epoll tells nothing more of it

    def _serve_drivers(self) -> None:
        """Whoever makes demands waits for nobody's turn: its dead-man's time runs."""
        for connection in [one for one in self._connections.values() if one.drives]:
            self._receive(connection, self._now_ns())
            self._serve(connection)

    def _receive(self, connection: Session, now_ns: int) -> None:
        if connection.wants_bytes:
            connection.receive(now_ns)
            self._tell_if_gone(connection)
            self._role(connection).check_extent(connection, now_ns)

    def _handle_line(self, connection: Session, now_ns: int) -> None:
        if now_ns < connection.pace.ready_ns:
            connection.waited = True
            return
        connection.pace.take(now_ns)
        self._counters.delayed += connection.waited
        connection.waited = False
        line = connection.take_line(now_ns)
        if connection.is_new and is_http(line):
            connection.head = []
        connection.is_new = False
        role = self._role(connection)
        role.handle(connection, line, now_ns)
        role.check_extent(connection, now_ns)
        self._deliver()

    def _role(self, connection: Session) -> RequestHandler | Scraping:
        return self._desk if connection.head is None else self._scraping

    def _send_updates(self) -> None:
        """Those that have been due for longest."""
        due = [
            (subscription.due_ns, subscription.number, subscription, connection)
            for connection in self._connections.values()
            for subscription in connection.live_subscriptions
        ]
        for due_ns, _, subscription, connection in sorted(due)[:_UPDATES_PER_ROUND]:
            if due_ns <= time.monotonic_ns():
                self._desk.update(connection, subscription, self._now_ns())

    def _look_at_all(self) -> None:
        """End what has to end, and find out when to look again."""
        now_ns = self._now_ns()
        wakes = [self._look_at(connection, now_ns) for connection in [*self._connections.values()]]
        for reception in self._receptions:
            is_open = now_ns >= reception.ready_ns
            self._watch(reception.sock.fileno(), select.EPOLLIN if is_open else 0)
            wakes.append(None if is_open else reception.ready_ns)
        self._wake_ns = min((wake for wake in wakes if wake is not None), default=None)

    def _look_at(self, connection: Session, now_ns: int) -> int | None:
        """When to look again."""
        self._tell_if_gone(connection)
        reason = connection.verdict(now_ns)
        if reason is not None:
            self._end(connection, reason)
            return None
        self._watch(connection.sock.fileno(), connection.events)
        return connection.next_ns(now_ns)

    def _watch(self, fd: int, events: int) -> None:
        """Tell epoll what matters of this descriptor, where that has changed."""
        before = self._watched.get(fd, 0)
        if events and not before:
            self._epoll.register(fd, events)
        elif events and events != before:
            self._epoll.modify(fd, events)
        elif before and not events:
            self._epoll.unregister(fd)
        self._watched[fd] = events

    def _tell_if_gone(self, connection: Session) -> None:
        """The demand of a connection ends as soon as its peer has."""
        if connection.peer_ended and not connection.is_told:
            connection.is_told = True
            if connection.caller is not None:
                self._service.gone(connection.caller)

    def _end(self, connection: Session, reason: str) -> None:
        self._watch(connection.sock.fileno(), 0)
        del self._watched[connection.sock.fileno()]
        del self._connections[connection.sock.fileno()]
        self._counters.clients -= connection.caller is not None
        connection.peer_ended = True
        with connection.sock:  # closed last: whoever sees the end finds it told and counted
            self._tell_if_gone(connection)
            if reason:
                self._counters.count_closed(reason)
                if connection.caller is not None:
                    self._service.closed(connection.caller, reason)

    def _is_pending(self) -> bool:
        return any(c.unanswered or c.has_output for c in self._connections.values())
