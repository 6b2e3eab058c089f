"""The metrics to whoever speaks HTTP; see api.http for what is understood."""

import functools

from vcu_gateway.server import http
from vcu_gateway.server.service import RequestService
from vcu_gateway.server.session import Session
from vcu_gateway.server.tick_gaps import TickGaps

_COST_NS = 10_000_000
_FRESH_NS = 100_000_000


class Scraping:
    """Answers one request of a connection, then ends it."""

    def __init__(self, service: RequestService, gaps: TickGaps) -> None:
        self._service = service
        self._gaps = gaps
        self._made: tuple[int, bytes] | None = None

    def check_extent(self, connection: Session, now_ns: int) -> None:
        """Refuse a head that is longer than a head may be, before it has ended."""
        size = sum(len(line) + 1 for line in connection.head or ())
        size += len(connection.lines) if connection.lines.is_partial else 0
        if size > http.MAX_HEAD_BYTES and not connection.is_ending:
            what = f"a head has at most {http.MAX_HEAD_BYTES} bytes"
            self._end(connection, http.Answer(431, what), now_ns)

    def handle(self, connection: Session, line: bytes, now_ns: int) -> None:
        """Add one line of the head; the empty one at its end brings the answer."""
        head = connection.head = connection.head or []
        head.append(line)
        if not line.strip(b"\r"):
            answer = http.judge(head[:-1], must_be_local=connection.caller is None)
            self._end(connection, answer, now_ns)

    def _end(self, connection: Session, answer: http.Answer, now_ns: int) -> None:
        text = functools.partial(self._text, now_ns)
        connection.send(http.response(answer, text), now_ns)
        connection.end_after_output("")

    def _text(self, now_ns: int) -> bytes:
        """The metrics, made anew only where they are not fresh: making them takes long."""
        if self._made is None or now_ns - self._made[0] > _FRESH_NS:
            self._gaps.wait(_COST_NS)
            self._made = now_ns, self._service.metrics()
        return self._made[1]
