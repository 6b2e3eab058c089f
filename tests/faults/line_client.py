"""Line client: one connection to the API's socket, lines out and lines in."""

import json
import socket
from pathlib import Path
from types import TracebackType
from typing import Any, Self

PATIENCE_S = 10.0


class LineClient:
    """One connection; `request` returns the answer."""

    def __init__(self, path: Path) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(PATIENCE_S)
        self.socket.connect(str(path))
        self._reader = self.socket.makefile("rb")
        self._id = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._reader.close()
        self.socket.close()

    def request(self, method: str, **params: Any) -> dict[str, Any]:
        """The whole answer: `result` or `error`."""
        self._id += 1
        request = {"jsonrpc": "2.0", "id": self._id, "method": method, "params": params}
        return self.line(json.dumps(request).encode())

    def result(self, method: str, **params: Any) -> Any:
        answer = self.request(method, **params)
        assert "result" in answer, answer
        return answer["result"]

    def line(self, text: bytes) -> dict[str, Any]:
        """The answer to these bytes and a line's end."""
        self.socket.sendall(text + b"\n")
        answer: dict[str, Any] = json.loads(self._reader.readline())
        return answer

    def demand(self, sequence: int, throttle_pct: float, ttl_ms: int = 1000) -> dict[str, Any]:
        values = {"throttle_pct": throttle_pct, "power_mode": "normal"}
        return self.request(
            "demand.set", source="driver", sequence=sequence, ttl_ms=ttl_ms, values=values
        )
