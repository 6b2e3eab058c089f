"""The metrics, which travel as one HTTP page on the same socket."""

from vcu_gateway.client.errors import ApiError, GarbledError

REQUEST = b"GET /metrics HTTP/1.0\r\n\r\n"
"""The page ends with the connection."""

MAX_PAGE_BYTES = 4 * 1024 * 1024

_OK = 200


class Page:
    """Gathers the page until the connection ends."""

    def __init__(self) -> None:
        self._bytes = bytearray()

    def feed(self, data: bytes) -> None:
        """Some more of it; GarbledError where it does not end."""
        self._bytes += data
        if len(self._bytes) > MAX_PAGE_BYTES:
            raise GarbledError(f"the gateway sent metrics of more than {MAX_PAGE_BYTES} bytes")

    def text(self) -> str:
        """Prometheus's text format; ApiError where the gateway has no metrics."""
        head, blank, body = bytes(self._bytes).partition(b"\r\n\r\n")
        status_line, *header_lines = head.decode("latin-1").split("\r\n")
        status = _status(status_line)
        if not blank or not status:
            raise GarbledError(f"the gateway sent no page of metrics: {head[:80]!r}")
        text = _whole(header_lines, body).decode("utf-8", "replace")
        if status != _OK:
            raise ApiError(status, f"http_{status}", text.strip() or status_line)
        return text


def _status(status_line: str) -> int:
    """The HTTP status; 0 where the line has none."""
    version, status, *_ = [*status_line.split(), "", ""]
    return int(status) if version.startswith("HTTP/") and status.isdecimal() else 0


def _whole(header_lines: list[str], body: bytes) -> bytes:
    """The body; GarbledError where the head promised another length."""
    parted = (line.partition(":") for line in header_lines)
    headers = {name.strip().lower(): value.strip() for name, _, value in parted}
    length = headers.get("content-length", "")
    if length.isdecimal() and len(body) != int(length):
        raise GarbledError(f"the page of metrics has {len(body)} of {length} bytes")
    return body
