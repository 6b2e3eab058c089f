"""A plain socket in the recorder's place, and the replay of what it got."""

import contextlib
import socket
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tests.core.test_invariants import CODEC
from tests.recording.tapped import frames_of
from vcu_gateway.core.calls import RunTick
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.recording import datagram
from vcu_gateway.recording.checkpoint import restore, state_of
from vcu_gateway.recording.core_lines import (
    Checkpoint,
    LineParser,
    ShellEvent,
    TickRecord,
    WhyRecord,
)
from vcu_gateway.recording.datagram import HelloPart, HelloText, TickParts

_LONGEST_BYTES = 1 << 20


class TapListener:
    """Takes connections of the gateway, one after the other.

    Attributes:
        connections: the datagrams of each.
        reading: cleared, what comes stays in the socket.
    """

    def __init__(self, path: Path) -> None:
        self.connections: list[list[bytes]] = []
        self.reading = threading.Event()
        self.reading.set()
        self._listening = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._listening.bind(str(path))
        self._listening.listen(4)
        self._socket: socket.socket | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                self._socket, _ = self._listening.accept()
                self._read(self._socket)

    def _read(self, connection: socket.socket) -> None:
        datagrams: list[bytes] = []
        with contextlib.suppress(OSError):
            while self.reading.wait() and (received := connection.recv(_LONGEST_BYTES)):
                if not datagrams:  # one that brings nothing only ends a wait
                    self.connections.append(datagrams)
                datagrams.append(received)
        connection.close()

    def close_connection(self) -> None:
        """As a recorder does that is to begin again."""
        if self._socket is not None:
            with contextlib.suppress(OSError):  # the gateway has ended it
                self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self.close_connection()
        self._thread.join(10)

    @property
    def ticks(self) -> int:
        """Ticks' datagrams of all connections."""
        return sum(one[0] == datagram.TICK for each in self.connections for one in list(each))


class Replayed(NamedTuple):
    """What the datagrams of one connection held, all of it the same in another core."""

    hello: Mapping[str, Any]
    checkpoints: int
    ticks: list[TickRecord]
    sentences: list[str]
    events: list[str]
    frames: int
    last: TickParts | None


def replayed(datagrams: list[bytes]) -> Replayed:
    """Give the core of the first checkpoint everything that follows, and compare each result."""
    text, parser, hello = HelloText(), LineParser(), None
    seen = Replayed({}, 0, [], [], [], 0, None)
    gateway, segment_frames, checkpoints, frames = None, 0, 0, 0
    last = None
    for one in map(datagram.unpack, datagrams):
        if isinstance(one, HelloPart):
            hello = text.take(one)
            continue
        last = one
        waiting = frames_of(one.frames)
        frames += len(waiting)
        for line in one.lines.splitlines():
            for before, record in parser.records(line):
                if isinstance(record, Checkpoint):
                    gateway, segment_frames = _at(gateway, record), 0
                    checkpoints += 1
                while segment_frames < before:
                    gateway.receive(waiting.pop(0))
                    segment_frames += 1
                _compare(gateway, record, seen)
        for frame in waiting:
            gateway.receive(frame)
            segment_frames += 1
    return seen._replace(hello=hello, checkpoints=checkpoints, frames=frames, last=last)


def _at(gateway: Gateway | None, checkpoint: Checkpoint) -> Gateway:
    """A core in this state: the one that has come there, or a new one where none has."""
    if gateway is not None and state_of(gateway) == checkpoint.state:
        return gateway
    return restore(checkpoint.state, CODEC, checkpoint.settings)


def _compare(gateway: Gateway, record: Any, seen: Replayed) -> None:
    if isinstance(record, TickRecord):
        result = RunTick(record.now_ns).apply(gateway)
        assert (result.frames, result.mode, result.events) == record[1:]
        seen.ticks.append(record)
    elif isinstance(record, WhyRecord):
        assert gateway.why(record.now_ns).sentence() == record.sentence
        seen.sentences.append(record.sentence)
    elif isinstance(record, ShellEvent):
        seen.events.append(record.event.name)
    elif not isinstance(record, Checkpoint):
        assert record.input.apply(gateway) == record.answer
