"""Tap: a gateway core that notes every call and its result, for the recorder, batch by batch.

It behaves as the core does, and costs an append a frame. Belongs to the ticking thread.
"""

import platform
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, NamedTuple, TypeVar

from vcu_gateway import __version__
from vcu_gateway.core.calls import Receive, RunTick
from vcu_gateway.core.causes import Event
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.gateway import CoreCall, Gateway, TickResult
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.schedule import ClockPair
from vcu_gateway.core.settings import Settings
from vcu_gateway.recording import checkpoint, datagram
from vcu_gateway.recording.call_text import settings_json
from vcu_gateway.recording.core_lines import (
    Checkpoint,
    LineWriter,
    NotedCall,
    ShellEvent,
    WhyRecord,
)


class Hello(NamedTuple):
    """Everything that reading and replaying a drive needs besides its inputs.

    Attributes:
        boot: id of the machine's boot; empty where it is not known.
        config: effective configuration as YAML; config_digest: that of `check-config`.
        dbc: text of the DBC; dbc_digest: the begin of its SHA-256.
    """

    run: str
    boot: str
    channel: str
    clock: ClockPair
    settings: Settings
    config: str
    config_digest: str
    dbc: str
    dbc_digest: str

    def values(self) -> dict[str, Any]:
        return self._asdict() | {
            "format": datagram.FORMAT,
            "versions": {
                "gateway": __version__,
                "python": platform.python_version(),
                "kernel": platform.release(),
                "machine": platform.machine(),
            },
            "clock": asdict(self.clock),
            "settings": settings_json(self.settings),
        }


_Answer = TypeVar("_Answer")


class Tap:
    """Gathers frames and calls in the order in which the core was given them.

    Frames and calls are those since the last take; events are of the last tick's result.
    """

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.calls: list[NotedCall] = []
        self.ticks = 0
        self.events: tuple[Event, ...] = ()

    def note(self, what: CoreCall[object] | WhyRecord | ShellEvent, answer: object = None) -> None:
        """A call that was made, or what is to stand at this place beside the calls."""
        self.calls.append(NotedCall(len(self.frames), what, answer))

    def take(self) -> tuple[list[Frame], list[NotedCall]]:
        """Frames and calls since the last take, each in its order."""
        noted = self.frames[:], self.calls[:]
        self.frames.clear()
        self.calls.clear()
        return noted


class TappedGateway(Gateway):
    """Gateway core whose calls are noted; those that are made by `apply`, frames and ticks."""

    # Not among the attributes of the core: a checkpoint keeps those.
    __slots__ = ("_note_frame", "tap")

    def __init__(self, codec: Codec, settings: Settings, now_ns: int, tap: Tap) -> None:
        super().__init__(codec, settings, now_ns)
        self.tap = tap
        self._note_frame = tap.frames.append

    def apply(self, call: CoreCall[_Answer]) -> _Answer:
        """Make a call, and note it with its answer; one that fails is noted without."""
        if isinstance(call, (Receive, RunTick)):  # the gateway's own methods note these
            return call.apply(self)
        return self._noted(call, lambda: call.apply(self))

    def receive(self, frame: Frame) -> None:
        self._note_frame(frame)
        self.receiver.receive(frame)

    def tick(self, now_ns: int) -> TickResult:
        result = self._noted(RunTick(now_ns), lambda: super(TappedGateway, self).tick(now_ns))
        self.tap.ticks += 1
        self.tap.events = result.events
        return result

    def _noted(self, call: CoreCall[object], make: Callable[[], _Answer]) -> _Answer:
        try:
            answer = make()
        except Exception:
            self.tap.note(call)
            raise
        self.tap.note(call, answer)
        return answer


def packed_frames(frames: list[Frame]) -> list[bytes]:
    pack, extended = datagram.CLASSIC.pack, datagram.EXTENDED
    return [
        pack(frame.arrival_ns, frame.can_id | extended, frame.own_echo, 8, frame.data)
        if frame.extended and len(frame.data) == 8 and not frame.error and not frame.remote
        else datagram.packed_frame(*recorded_frame(frame))
        for frame in frames
    ]


def recorded_frame(frame: Frame) -> datagram.FrameRecord:
    """The frame with Linux's flags in its identifier."""
    flags = frame.extended * datagram.EXTENDED | frame.remote * datagram.REMOTE
    can_id = frame.can_id & datagram.ID_MASK | flags | frame.error * datagram.ERROR
    return datagram.FrameRecord(frame.arrival_ns, can_id, frame.own_echo, bytes(frame.data))


class TapStream:
    """What a recording is made of; used by the ticking thread, after its ticks.

    A recording begins with `begin`, and again after whatever could not be recorded. In between a
    batch is taken after each tick.

    Attributes:
        frames: since the start of the gateway, up to the last batch.
        writer: of the lines since the last checkpoint.
    """

    def __init__(self, gateway: TappedGateway) -> None:
        self._gateway = gateway
        self.writer = LineWriter()
        self._head = ""
        self._why: object = None
        self.frames = 0

    def begin(self, now_ns: int, wall_ns: int) -> None:
        """Begin a segment with the gateway's state; what was not taken before is part of it."""
        self.skip()
        gateway, why = self._gateway, self._gateway.why(now_ns)
        self._head = self.writer.begin(
            Checkpoint(
                state=checkpoint.state_of(gateway),
                settings=gateway.settings,
                mode=gateway.mode,
                why=why.sentence(),
                now_ns=now_ns,
                wall_ns=wall_ns,
                ticks=gateway.tap.ticks,
                frames=self.frames,
            )
        )

    def note_why(self, now_ns: int, signature: object) -> None:
        """After a tick: its explanation, where the signature says that it is another one."""
        if signature != self._why:
            self._why = signature
            sentence = self._gateway.why(now_ns).sentence()
            self._gateway.tap.note(WhyRecord(now_ns, sentence))

    def batch(self) -> tuple[list[Frame], str]:
        """Frames and the core lines that belong to them, which may begin with a checkpoint."""
        frames, calls = self._gateway.tap.take()
        self.frames += len(frames)
        head, self._head = self._head, ""
        return frames, head + self.writer.lines(calls, len(frames))

    def skip(self) -> int:
        """Leave out everything since the last batch; how many frames that were."""
        frames, _ = self._gateway.tap.take()
        self.frames += len(frames)
        return len(frames)
