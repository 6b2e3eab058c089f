"""The gateway's API as docs/api.md describes it: JSON-RPC lines over a Unix socket."""

import json
import socket
import time
from typing import Any


class RefusedError(Exception):
    def __init__(self, error: dict) -> None:
        super().__init__(error.get("message"))
        self.code = error.get("code")
        self.message = error.get("message", "")
        self.data = error.get("data") or {}

    @property
    def refusal(self) -> str | None:
        return self.data.get("refusal")


class Client:
    """One connection."""

    def __init__(self, path: str, timeout_s: float = 20.0) -> None:
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.settimeout(timeout_s)
        self.socket.connect(path)
        self.lines = self.socket.makefile("rb")
        self.number = 0

    def line(self, method: str, **params: Any) -> bytes:
        self.number += 1
        request = {"jsonrpc": "2.0", "id": self.number, "method": method, "params": params}
        return json.dumps(request).encode() + b"\n"

    def write(self, *lines: bytes) -> None:
        """Several requests in one write."""
        self.socket.sendall(b"".join(lines))

    def answer(self) -> dict:
        line = self.lines.readline()
        if not line:
            raise ConnectionError("the gateway closed the connection")
        return json.loads(line)

    def call(self, method: str, **params: Any) -> dict:
        self.write(self.line(method, **params))
        answer = self.answer()
        if "error" in answer:
            raise RefusedError(answer["error"])
        return answer["result"]

    def refusal(self, method: str, **params: Any) -> RefusedError | None:
        """What a request is refused with, or None where it was granted."""
        try:
            self.call(method, **params)
        except RefusedError as refused:
            return refused
        return None

    def demand_params(self, source: str, ttl_ms: int | None = 1000, **values: Any) -> dict:
        """values: of both controllers; or controllers=..."""
        what = values if "controllers" in values else {"values": values}
        sequence = time.monotonic_ns() // 1000
        return {"source": source, "sequence": sequence, "ttl_ms": ttl_ms, **what}

    def demand(self, source: str, ttl_ms: int | None = 1000, **values: Any) -> dict:
        return self.call("demand.set", **self.demand_params(source, ttl_ms, **values))

    def refused_demand(self, source: str, **values: Any) -> str | None:
        refused = self.refusal("demand.set", **self.demand_params(source, **values))
        return None if refused is None else (refused.refusal or refused.message)

    def close(self) -> None:
        self.lines.close()
        self.socket.close()

    def __enter__(self) -> "Client":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
