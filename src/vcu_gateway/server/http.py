"""As much HTTP as `curl http://localhost/metrics` and Prometheus need, without a socket."""

import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

from vcu_gateway.api.errors import RequestError

MAX_HEAD_BYTES = 8_192

_BEGINNING = re.compile(rb"[A-Z]{3,16} ")
_REQUEST_LINE = re.compile(r"([A-Z]{3,16}) (\S+) HTTP/1\.[0-9]")
_TARGET = re.compile(r"(?:http://[^/?#]*)?/metrics(?:\?.*)?")
_LOCAL_HOST = re.compile(r"(?:localhost|127\.0\.0\.1|\[::1\])(?::[0-9]{1,5})?", re.IGNORECASE)
_REASONS = {
    200: "OK",
    400: "Bad Request",
    403: "Forbidden",
    404: "Not Found",
    405: "Method Not Allowed",
    431: "Request Header Fields Too Large",
    503: "Service Unavailable",
}
_TEXT = "text/plain; charset=utf-8"
_METRICS = "text/plain; version=0.0.4; charset=utf-8"


class Answer(NamedTuple):
    """What is answered to a head; `wants_metrics` where all was well."""

    status: int
    sentence: str = ""
    has_body: bool = True

    @property
    def wants_metrics(self) -> bool:
        """True where the metrics are the body."""
        return self.status == 200


def is_http(line: bytes) -> bool:
    """True where a connection's first line is no JSON, but the beginning of HTTP."""
    return _BEGINNING.match(line) is not None


def judge(head: Sequence[bytes], must_be_local: bool) -> Answer:
    """What to answer to these lines, the empty one at the end left out.

    `must_be_local` refuses names that some web page made point to this machine.
    """
    lines = [line.decode("latin-1").rstrip("\r") for line in head]
    request = _REQUEST_LINE.fullmatch(lines[0])
    if request is None:
        return Answer(400, "this is neither JSON-RPC nor HTTP/1")
    if must_be_local and not _is_for_this_machine(lines[1:]):
        return Answer(403, "the Host header must be localhost, 127.0.0.1 or [::1]")
    if request[1] not in ("GET", "HEAD"):
        return Answer(405, "only GET and HEAD")
    has_body = request[1] == "GET"
    if _TARGET.fullmatch(request[2]) is None:
        return Answer(404, "there is only /metrics", has_body)
    return Answer(200, "", has_body)


def response(answer: Answer, metrics: Callable[[], bytes]) -> bytes:
    """The whole response; `metrics` is called where the answer needs them."""
    kind, body = _TEXT, f"{answer.sentence}\n".encode()
    if answer.wants_metrics:
        try:
            kind, body = _METRICS, metrics()
        except RequestError as failure:
            answer = answer._replace(status=503)
            body = f"{failure.sentence}\n".encode()
    head = [
        f"HTTP/1.1 {answer.status} {_REASONS[answer.status]}",
        f"Content-Type: {kind}",
        f"Content-Length: {len(body)}",
        "Connection: close",
    ]
    if answer.status == 405:
        head.append("Allow: GET, HEAD")
    return "\r\n".join([*head, "", ""]).encode("ascii") + (body if answer.has_body else b"")


def _is_for_this_machine(fields: Sequence[str]) -> bool:
    hosts = [
        value.strip()
        for name, _, value in (field.partition(":") for field in fields)
        if name.lower() == "host"
    ]
    return len(hosts) == 1 and _LOCAL_HOST.fullmatch(hosts[0]) is not None
