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
3. accept some of those that wait, without a place yet, and read what each has sent;
4. send the replies that have come;
5. carry out every stop that was read;
6. give some of those that wait for one a place, the user with fewest places first;
7. serve one request of each session with a place, and before each those of all drivers;
8. send a few updates of subscriptions, the longest due first;
9. close the sessions that have to end, and compute the next timeout.

Stops. `estop` and `disarm` pass over what waits, on their own connection too: what has come is
read also behind requests that wait, and each whole line that may name a stop is looked at before
anything else is served, eight a turn, or one of each session. A stop needs no place. What waits on
that connection then, before or behind the stop, is overtaken: `arm`, `reset` and `demand.set` are
refused, the rest is served. Stops that wait for the ticking thread together are one to it.

Fairness. A session has one request a turn, whatever it has sent. A session that has made a demand
is a driver: it is read and served between all the others, because its demand expires in some
100 ms and a flood of others must not use that time up.

Bounds. The number of sessions; of each session the rate of requests, the requests without a reply,
the length of a line, the time for it to end, the requests that wait, and unread output.
A session beyond its rate, its pending requests or its output is not served, and not read where
256 KiB wait, so the kernel's buffer holds its sender up. The end of a peer is seen even then
(EPOLLRDHUP): a demand must not outlive its connection. A slow reader loses updates; one that does
not read at all is closed.

Places. Where all are taken, the longest idle session is evicted for the new one; a user with more
than half of the places makes room among its own. Some places are reserved for peers that may do
more than read. A session that owns a fresh demand is never evicted; a stop and the first request
that a session had sent before are carried out first. So nobody can be kept from `estop` and
`disarm` by others, short of demands in every place, and these two are carried out even where they
are malformed.
"""

import contextlib
import select
import time
from collections import Counter

from vcu_gateway.api.errors import ErrorCode, RequestError
from vcu_gateway.server.acceptor import Acceptor, has_left, may_only_read
from vcu_gateway.server.request_handler import RequestHandler
from vcu_gateway.server.service import Caller, Counters, ReplyQueue, RequestService, SessionLimits
from vcu_gateway.server.session import EVICTED, Session
from vcu_gateway.server.tick_gaps import TickGaps
from vcu_gateway.units import NS_PER_S

_UPDATES_PER_TURN = 4
_ACCEPTED_PER_TURN = 64
_MAX_UNSEATED = 256
_SEATED_PER_TURN = 8
_LOOKED_AT_PER_TURN = 8
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
        waiting = [session for session in self._sessions.values() if session.lines.has_line]
        for session in waiting:
            self._serve_stops(session, max(1, _LOOKED_AT_PER_TURN // len(waiting)))
        self._seat()
        for session in self._seated():
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
        """Take some of those that wait, without a place yet, and read what each has sent."""
        for _ in range(_ACCEPTED_PER_TURN):
            now_ns = self._now_ns()
            sock = self._acceptor.next_socket(now_ns)
            if sock is None:
                return
            self._counters.accepted += 1
            if has_left(sock):
                sock.close()
                continue
            session = self._acceptor.session(sock, now_ns)
            self._sessions[sock.fileno()] = session
            self._receive(session, now_ns)

    def _seat(self) -> None:
        """Give some of those without a place one, first those whose user has fewest."""
        for _ in range(_SEATED_PER_TURN):
            waiting = self._unseated()
            if not waiting:
                break
            seated, gave_way = self._seated(), self._counters.gave_way
            of_user = Counter(one.caller.peer.uid for one in seated)
            self._seat_one(min(waiting, key=lambda one: of_user[one.caller.peer.uid]))
            if self._counters.gave_way > gave_way and not any(one.peer_is_lost for one in seated):
                break  # of those that are in some may leave by themselves
        while len(waiting := self._unseated()) > _MAX_UNSEATED:
            most = Counter(one.caller.peer.uid for one in waiting).most_common(1)[0][0]
            self._turn_away(next(one for one in waiting if one.caller.peer.uid == most))

    def _seat_one(self, session: Session) -> None:
        callers = [one.caller for one in self._seated()]
        readers = sum(map(may_only_read, callers))
        if not self._acceptor.has_place(session.caller, len(callers), readers, self._evict_one):
            self._turn_away(session)
            return
        session.is_seated = True
        self._counters.clients += 1

    def _turn_away(self, session: Session) -> None:
        self._now_ns()
        self._acceptor.turn_away(session.sock)
        self._close(session, "")

    def _seated(self) -> list[Session]:
        return [session for session in self._sessions.values() if session.is_seated]

    def _unseated(self) -> list[Session]:
        """Connections without a place, the first come first."""
        return [session for session in self._sessions.values() if not session.is_seated]

    def _evict_one(self, caller: Caller, must_be_reader: bool) -> bool:
        """Close the longest idle session without a fresh demand; False where there is none.

        One whose peer is lost goes first. A user with more than half of the places makes room among
        its own: a flood of connections does not push out those of others.
        """
        sessions = self._seated()
        own = [one for one in sessions if one.caller.peer.uid == caller.peer.uid]
        candidates = own if 2 * len(own) > len(sessions) else sessions
        for session in sorted(candidates, key=lambda one: (not one.peer_is_lost, one.active_ns)):
            is_allowed = not must_be_reader or may_only_read(session.caller)
            if is_allowed and not self._service.owns_demand(session.caller):
                self._evict(session)
                return True
        return False

    def _evict(self, session: Session) -> None:
        """Carry out a stop and the first request that were sent before, and close."""
        while self._receive(session, self._now_ns()):
            pass
        self._serve_stops(session)
        self._serve(session)
        self._counters.gave_way += 1
        self._close(session, EVICTED)

    def _send_replies(self) -> None:
        while self._replies.queued:
            queued = self._replies.queued.popleft()
            for session in self._sessions.values():
                if session.caller.connection == queued.connection:
                    self._handler.reply(session, queued.number, queued.reply, self._now_ns())

    def _serve_stops(self, session: Session, most_lines: int = _LOOKED_AT_PER_TURN) -> None:
        """Carry out the stops that it has sent; so many lines that may name one are looked at."""
        for _ in range(most_lines):
            line = session.next_marked()
            if line is None:
                return
            self._handler.handle_marked(session, line, self._now_ns())
            self._send_replies()

    def _serve_drivers(self) -> None:
        """Serve one request of every session that makes demands: these expire."""
        for session in [one for one in self._sessions.values() if one.is_driver]:
            self._receive(session, self._now_ns())
            self._serve(session)

    def _serve(self, session: Session) -> None:
        """Serve one request of this session, if it may have one now."""
        if session.peer_ended:
            self._receive(session, self._now_ns())  # epoll reports nothing more of it
        if session.lines.has_line and self._handler.handle_next(session, now_ns := self._now_ns()):
            self._check_line_length(session, now_ns)
            self._send_replies()

    def _receive(self, session: Session, now_ns: int) -> bool:
        """Read one chunk where it may be; True where more may have come."""
        has_more = session.receive(now_ns)
        self._end_demands_if_ended(session)
        self._check_line_length(session, now_ns)
        return has_more

    def _check_line_length(self, session: Session, now_ns: int) -> None:
        """Refuse a line that exceeds the length before it has ended, and close the session."""
        if session.lines.is_too_long and not session.is_ending:
            self._handler.refuse_line(session, now_ns)
            session.is_ending = True

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
        timeouts.append(now_ns if self._unseated() else None)
        self._next_check_ns = min((one for one in timeouts if one is not None), default=None)

    def _check_session(self, session: Session, now_ns: int) -> int | None:
        """Time of the next check of this session; None where only events matter."""
        self._end_demands_if_ended(session)
        due = session.due(now_ns)
        if due.close_reason is not None:
            self._close(session, due.close_reason)
            return None
        self._watch(session.sock.fileno(), due.events)
        return due.next_check_ns

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
        self._counters.clients -= session.is_seated
        session.peer_ended = True
        with session.sock:  # closed last: a peer that sees the end finds it counted
            self._end_demands_if_ended(session)
            if reason:
                self._counters.closed[reason] += 1
                self._service.log_closed(session.caller, reason)

    def _is_pending(self) -> bool:
        return any(one.pending or one.has_output for one in self._sessions.values())
