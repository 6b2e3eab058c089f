"""Event loop of the API: serves every session in turn, in the gaps between the ticks.

Threads. One thread, "api", runs the loop and owns everything in it: sockets, sessions,
subscriptions, counters. Queries are answered on it at once, from values that never change.
Commands are posted to the ticking thread; their replies come back through the `ReplyQueue`, the
only object that another thread touches, and its descriptor wakes the loop. There is no lock.

Gaps. The ticking thread and this one share the interpreter, so every unit of work (one chunk read,
one request, one update, one reply) is preceded by `TickGaps.wait`: nothing begins shortly before
or after a tick, and at most a share of each period is used. A unit is short because its input is
bounded: a line of 64 KiB, a number of JSON values, and so on.

One turn, `run_once`:

1. wait in epoll until a socket or a reply is ready, or a timeout is due;
2. handle the sockets' events: end of a peer first, then output, then one chunk of input;
3. accept one connection;
4. send the replies that have come;
5. serve one request of each session, and before each of them those of all drivers;
6. send a few updates of subscriptions, the longest due first;
7. close the sessions that have to end, and compute the next timeout.

Fairness. A session has one request a turn, whatever it has sent. A session that has made a demand
is a driver: it is read and served between all the others, because its demand expires in some
100 ms and a flood of others must not use that time up.

Bounds. The number of sessions and the rate of accepting; of each session the rate of requests,
the requests without a reply, the length of a line, the time for it to end, and unread output.
A session beyond its rate, its pending requests or its output is not read, so the kernel's buffer
holds its sender up. The end of a peer is seen even then (EPOLLRDHUP): a demand must not outlive
its connection. A slow reader loses updates; one that does not read at all is closed.

Places. Where all are taken, the longest idle session is evicted for the new one; a user with more
than half of the places makes room among its own. Some places are reserved for peers that may do
more than read. A session that owns a fresh demand is never evicted, and whatever a session had
sent before is carried out first. So nobody can be kept from `estop` and `disarm` by others, short
of demands in every place, and these two are carried out even where they are malformed.
"""

import contextlib
import select
import time

from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.server.acceptor import Acceptor, ConnectionCounts, may_only_read
from vcu_gateway.server.counters import Counters
from vcu_gateway.server.reply_queue import ReplyQueue
from vcu_gateway.server.request_handler import RequestHandler
from vcu_gateway.server.service import Caller, RequestService
from vcu_gateway.server.session import EVICTED, Session
from vcu_gateway.server.settings import SessionLimits
from vcu_gateway.server.tick_gaps import TickGaps
from vcu_gateway.units import NS_PER_S

_UPDATES_PER_TURN = 4
_LINGER_CHECK_S = 0.005


class EventLoop:
    """Sessions and the listening socket, on the API's thread; the module says how they are served.

    Only the constructor may be called from another thread.
    """

    def __init__(
        self,
        service: RequestService,
        gaps: TickGaps,
        limits: SessionLimits,
        acceptor: Acceptor,
        replies: ReplyQueue,
        counters: Counters,
    ) -> None:
        self._service = service
        self._gaps = gaps
        self._limits = limits
        self._acceptor = acceptor
        self._replies = replies
        self._counters = counters
        self._handler = RequestHandler(service, counters, replies.put)
        self._sessions: dict[int, Session] = {}
        self._watched_events: dict[int, int] = {}
        self._epoll = select.epoll()
        self._watch(replies.fd, select.EPOLLIN)
        self._next_check_ns: int | None = time.monotonic_ns()

    def run_once(self) -> None:
        """Wait for events and handle them: one turn."""
        events = dict(self._epoll.poll(self._timeout_s()))
        for fd in self._sessions.keys() & events.keys():
            self._on_event(self._sessions[fd], events[fd])
        if self._acceptor.sock.fileno() in events:
            self._accept()
        if self._replies.fd in events:
            self._replies.clear_wakeup()
        self._send_replies()
        for session in list(self._sessions.values()):
            self._serve_drivers()
            self._serve(session)
        self._send_updates()
        self._check_timeouts()

    def finish(self) -> None:
        """Send pending replies, for `linger_ns` at most; nothing new is read."""
        end_ns = time.monotonic_ns() + self._limits.linger_ns
        while self._is_pending() and time.monotonic_ns() < end_ns:
            time.sleep(_LINGER_CHECK_S)
            self._send_replies()
            for session in self._sessions.values():
                if session.has_output:
                    session.flush(self._now_ns())
        ending = RequestError(ErrorCode.NOT_READY, "the gateway is ending")
        for session in self._sessions.values():
            for number in list(session.pending):
                self._handler.reply(session, number, ending, self._now_ns())

    def close(self) -> None:
        """Close every session, also where the service raises at one of them."""
        with self._epoll, contextlib.ExitStack() as stack:
            for session in list(self._sessions.values()):
                stack.callback(self._close, session, "")

    def _now_ns(self) -> int:
        """Time after waiting for a gap in which one unit of work fits."""
        self._gaps.wait()
        return time.monotonic_ns()

    def _timeout_s(self) -> float | None:
        if self._next_check_ns is None:
            return None
        return max(0.0, (self._next_check_ns - time.monotonic_ns()) / NS_PER_S)

    def _on_event(self, session: Session, event: int) -> None:
        now_ns = self._now_ns()
        if event & (select.EPOLLHUP | select.EPOLLERR):
            session.mark_lost()
        if event & select.EPOLLRDHUP:
            session.peer_ended = True
        self._end_demands_if_ended(session)
        if event & select.EPOLLOUT and session.has_output:
            session.flush(now_ns)
        if event & select.EPOLLIN:
            self._receive(session, now_ns)

    def _accept(self) -> None:
        session = self._acceptor.accept(self._connection_counts(), self._evict_one, self._now_ns())
        if session is not None:
            self._sessions[session.sock.fileno()] = session
            self._counters.clients += 1

    def _connection_counts(self) -> ConnectionCounts:
        callers = [session.caller for session in self._sessions.values()]
        return ConnectionCounts(len(callers), sum(map(may_only_read, callers)))

    def _evict_one(self, caller: Caller, must_be_reader: bool) -> bool:
        """Close the longest idle session without a fresh demand; False where there is none.

        A user with more than half of the places makes room among its own: a flood of
        connections does not push out those of others.
        """
        sessions = list(self._sessions.values())
        own = [one for one in sessions if one.caller.peer.uid == caller.peer.uid]
        candidates = own if 2 * len(own) > len(sessions) else sessions
        for session in sorted(candidates, key=lambda one: one.active_ns):
            is_allowed = not must_be_reader or may_only_read(session.caller)
            if is_allowed and not self._service.owns_demand(session.caller):
                self._evict(session)
                return True
        return False

    def _evict(self, session: Session) -> None:
        """Carry out what was sent before, which may be an emergency stop, and close."""
        self._receive(session, self._now_ns())
        while session.has_request and time.monotonic_ns() >= session.rate.ready_ns:
            self._serve(session)
        self._counters.gave_way += 1
        self._close(session, EVICTED)

    def _send_replies(self) -> None:
        for queued in self._replies.take():
            for session in self._sessions.values():
                if session.caller.connection == queued.connection:
                    self._handler.reply(session, queued.number, queued.reply, self._now_ns())

    def _serve_drivers(self) -> None:
        """Serve one request of every session that makes demands: these expire."""
        for session in [one for one in self._sessions.values() if one.is_driver]:
            self._receive(session, self._now_ns())
            self._serve(session)

    def _serve(self, session: Session) -> None:
        """Serve one request of this session, if it may have one now."""
        if session.has_request:
            self._serve_line(session, self._now_ns())
        elif session.peer_ended:
            self._receive(session, self._now_ns())  # epoll reports nothing more of it

    def _serve_line(self, session: Session, now_ns: int) -> None:
        if now_ns < session.rate.ready_ns:
            session.is_delayed = True
            return
        session.rate.take(now_ns)
        self._counters.delayed += session.is_delayed
        session.is_delayed = False
        self._handler.handle(session, session.take_line(now_ns), now_ns)
        self._handler.check_line_length(session, now_ns)
        self._send_replies()

    def _receive(self, session: Session, now_ns: int) -> None:
        if session.wants_input:
            session.receive(now_ns)
            self._end_demands_if_ended(session)
            self._handler.check_line_length(session, now_ns)

    def _send_updates(self) -> None:
        """Send some of the updates that are due, the longest due first."""
        due = [
            (subscription.due_ns, subscription.number, subscription, session)
            for session in self._sessions.values()
            for subscription in session.live_subscriptions
        ]
        for due_ns, _, subscription, session in sorted(due)[:_UPDATES_PER_TURN]:
            if due_ns <= time.monotonic_ns():
                self._handler.send_update(session, subscription, self._now_ns())

    def _check_timeouts(self) -> None:
        """Close the sessions that have to end, and find the next timeout."""
        now_ns = self._now_ns()
        timeouts = [self._check_session(one, now_ns) for one in [*self._sessions.values()]]
        accepts = now_ns >= self._acceptor.ready_ns
        self._watch(self._acceptor.sock.fileno(), select.EPOLLIN if accepts else 0)
        timeouts.append(None if accepts else self._acceptor.ready_ns)
        self._next_check_ns = min((one for one in timeouts if one is not None), default=None)

    def _check_session(self, session: Session, now_ns: int) -> int | None:
        """Time of the next check of this session; None where only events matter."""
        self._end_demands_if_ended(session)
        reason = session.close_reason(now_ns)
        if reason is not None:
            self._close(session, reason)
            return None
        self._watch(session.sock.fileno(), session.events)
        return session.next_check_ns(now_ns)

    def _watch(self, fd: int, events: int) -> None:
        """Register these events of a descriptor with epoll, where they have changed."""
        before = self._watched_events.get(fd, 0)
        if events and not before:
            self._epoll.register(fd, events)
        elif events and events != before:
            self._epoll.modify(fd, events)
        elif before and not events:
            self._epoll.unregister(fd)
        self._watched_events[fd] = events

    def _end_demands_if_ended(self, session: Session) -> None:
        """End the demands of a peer that has ended, once."""
        if session.peer_ended and not session.has_ended_demands:
            session.has_ended_demands = True
            self._service.end_demands(session.caller)

    def _close(self, session: Session, reason: str) -> None:
        self._watch(session.sock.fileno(), 0)
        del self._watched_events[session.sock.fileno()]
        del self._sessions[session.sock.fileno()]
        self._counters.clients -= 1
        session.peer_ended = True
        with session.sock:  # closed last: a peer that sees the end finds it counted
            self._end_demands_if_ended(session)
            if reason:
                self._counters.count_closed(reason)
                self._service.log_closed(session.caller, reason)

    def _is_pending(self) -> bool:
        return any(one.pending or one.has_output for one in self._sessions.values())
