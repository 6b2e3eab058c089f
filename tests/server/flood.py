"""Floods a running gateway from one process, in every way at once.

    python -m tests.server.flood SOCKET --clients 50 --seconds 30

Prints one JSON line: what each kind of client did, and what became of it.
"""

import argparse
import contextlib
import itertools
import json
import random
import selectors
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

PAUSE_S = 0.01
SEED = 7
READING = ("state.get", "why", "health", "events", "protocol.get")


def request(number: int, method: str, **params: Any) -> bytes:
    message = {"jsonrpc": "2.0", "id": number, "method": method, "params": params}
    return json.dumps(message).encode() + b"\n"


def asked() -> Iterator[bytes]:
    """Well-formed requests, one at a time."""
    for number in itertools.count():
        yield request(number, READING[number % len(READING)])


def piled() -> Iterator[bytes]:
    """Many requests at once."""
    for number in itertools.count():
        yield request(number, READING[number % len(READING)]) * 50


def nonsense() -> Iterator[bytes]:
    """Long lines, garbage, nesting, half lines."""
    rng = random.Random(SEED)
    while True:
        yield b"[" * 65_000 + b"\n"
        yield b'{"a":' * 3_000 + b"\n"
        yield rng.randbytes(4_096) + b"\n"
        yield request(1, "demand.set", source="flood", sequence=rng.randrange(2**40), x=1)
        yield b"[" + b"9" * 4_000 + b"]\n"
        yield b"\n" * 500
        yield b"x" * 70_000


def subscribed() -> Iterator[bytes]:
    """Four subscriptions, as fast as they go."""
    for number in range(4):
        yield request(number, "state.subscribe", rate_hz=50)


def nothing() -> Iterator[bytes]:
    """Connect and leave."""
    yield from ()


class Kind:
    """How one kind of client behaves.

    Attributes:
        reads: it takes what it is sent; asks: it sends the next only after an answer.
        leaves: it goes as soon as it has nothing to send.
    """

    def __init__(
        self, texts: Callable[[], Iterator[bytes]], reads=False, asks=False, leaves=False
    ) -> None:
        self.texts = texts
        self.reads, self.asks, self.leaves = reads, asks, leaves


KINDS = {
    "asks": Kind(asked, reads=True, asks=True),
    "piles up": Kind(piled),
    "connects and leaves": Kind(nothing, leaves=True),
    "sends nonsense": Kind(nonsense, reads=True),
    "subscribes and never reads": Kind(subscribed),
}


class Flooder:
    """One client after the other, all of one kind."""

    def __init__(self, path: str, kind: Kind, counts: Counter) -> None:
        self._path = path
        self._kind = kind
        self._counts = counts
        self._out = b""
        self._is_silent = False
        self.sock: socket.socket | None = None
        self.again_s = 0.0

    def connect(self, selector: selectors.BaseSelector) -> None:
        sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        sock.setblocking(False)
        try:
            sock.connect(self._path)
        except OSError as error:
            self._counts[f"not connected: {error.strerror}"] += 1
            self.again_s = time.monotonic() + PAUSE_S
            sock.close()
            return
        self._counts["connected"] += 1
        self.sock, self._out, self._is_silent = sock, b"", False
        self._texts = self._kind.texts()
        self._next()
        if self._kind.leaves:
            self._leave(selector, "left")
            return
        selector.register(sock, self._events(), self)

    def on_event(self, selector: selectors.BaseSelector, events: int) -> None:
        try:
            if events & selectors.EVENT_READ and not self._read():
                self._leave(selector, "ended by the gateway")
                return
            if events & selectors.EVENT_WRITE:
                self._write()
        except BlockingIOError:
            pass
        except OSError as error:
            self._leave(selector, f"broken: {error.strerror}")
            return
        self._watch(selector)

    def _watch(self, selector: selectors.BaseSelector) -> None:
        events = self._events()
        if events:
            selector.modify(self.sock, events, self)
        else:  # it sends nothing more and reads nothing; look whether it still lives
            selector.modify(self.sock, selectors.EVENT_WRITE, self)

    def _events(self) -> int:
        reads = selectors.EVENT_READ if self._kind.reads else 0
        return reads | (selectors.EVENT_WRITE if self._out else 0)

    def _read(self) -> bool:
        data = self.sock.recv(262_144)
        self._counts["bytes read"] += len(data)
        self._counts["answers"] += data.count(b"\n")
        self._counts["turned away"] += data.count(b'"too_many_clients"')
        if self._kind.asks and data.endswith(b"\n"):
            self._next()
        return bool(data)

    def _write(self) -> None:
        sent = self.sock.send(self._out)
        self._counts["bytes sent"] += sent
        self._out = self._out[sent:]
        if not self._out and not self._kind.asks:
            self._next()

    def _next(self) -> None:
        self._out = next(self._texts, b"")
        self._counts["requests"] += self._out.count(b"\n")

    def _leave(self, selector: selectors.BaseSelector, how: str) -> None:
        self._counts[how] += 1
        with contextlib.suppress(KeyError):
            selector.unregister(self.sock)
        self.sock.close()
        self.sock = None


def flood(path: str, clients: int, seconds: float, kinds: list[str]) -> dict[str, Counter]:
    """Flood for so long; the counts by kind."""
    counts = {name: Counter() for name in kinds}
    names = itertools.islice(itertools.cycle(kinds), clients)
    flooders = [Flooder(path, KINDS[name], counts[name]) for name in names]
    end_s = time.monotonic() + seconds
    with selectors.DefaultSelector() as selector:
        while (now_s := time.monotonic()) < end_s:
            for flooder in flooders:
                if flooder.sock is None and now_s >= flooder.again_s:
                    flooder.connect(selector)
            for key, events in selector.select(PAUSE_S):
                key.data.on_event(selector, events)
    for flooder in flooders:
        if flooder.sock is not None:
            flooder.sock.close()
    return counts


def main() -> None:
    parser = argparse.ArgumentParser(description="flood a running gateway")
    parser.add_argument("socket")
    parser.add_argument("--clients", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    options = parser.parse_args()
    begin_s = time.monotonic()
    counts = flood(options.socket, options.clients, options.seconds, options.kinds)
    report = {
        "clients": options.clients,
        "seconds": round(time.monotonic() - begin_s, 1),
        "total": sum(counts.values(), Counter()),
        "kinds": counts,
    }
    print(json.dumps(report))


if __name__ == "__main__":
    main()
