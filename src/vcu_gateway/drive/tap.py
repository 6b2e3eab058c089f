"""Tap: a gateway core that notes every call and its result, for the recorder.

It behaves as the core does, and costs an append a frame. Belongs to the ticking thread.
"""

from typing import NamedTuple, TypeVar

from vcu_gateway.core.calls import Receive, RunTick
from vcu_gateway.core.causes import Event
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.gateway import CoreCall, Gateway, TickResult
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.drive.core_lines import NotedCall
from vcu_gateway.drive.records import ShellEvent, WhyRecord
from vcu_gateway.drive_format import datagram

_Answer = TypeVar("_Answer")


class Noted(NamedTuple):
    """Frames and calls since the last take, each in its order."""

    frames: list[Frame]
    calls: list[NotedCall]


class Tap:
    """Gathers frames and calls in the order in which the core was given them.

    Attributes:
        frames, calls: since the last take.
        ticks: so far.
        events: of the last tick's result.
    """

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.calls: list[NotedCall] = []
        self.ticks = 0
        self.events: tuple[Event, ...] = ()

    def note(self, what: CoreCall[object] | WhyRecord | ShellEvent, answer: object = None) -> None:
        """A call that was made, or what is to stand at this place beside the calls."""
        self.calls.append(NotedCall(len(self.frames), what, answer))

    def take(self) -> Noted:
        noted = Noted(self.frames[:], self.calls[:])
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
        try:
            answer = call.apply(self)
        except Exception:
            self.tap.note(call)
            raise
        self.tap.note(call, answer)
        return answer

    def receive(self, frame: Frame) -> None:
        self._note_frame(frame)
        self.receiver.receive(frame)

    def tick(self, now_ns: int) -> TickResult:
        tap = self.tap
        try:
            result = super().tick(now_ns)
        except Exception:
            tap.note(RunTick(now_ns))
            raise
        tap.note(RunTick(now_ns), result)
        tap.ticks += 1
        tap.events = result.events
        return result


def packed_frames(frames: list[Frame]) -> list[bytes]:
    pack, extended = datagram.CLASSIC.pack, datagram.EXTENDED
    return [
        pack(frame.arrival_ns, frame.can_id | extended, frame.own_echo, 8, frame.data)
        if frame.extended and len(frame.data) == 8 and not frame.error and not frame.remote
        else _packed_frame(frame)
        for frame in frames
    ]


def _packed_frame(frame: Frame) -> bytes:
    return datagram.packed_frame(*recorded_frame(frame))


def recorded_frame(frame: Frame) -> datagram.FrameRecord:
    """The frame with Linux's flags in its identifier."""
    can_id = frame.can_id & datagram.ID_MASK
    if frame.extended:
        can_id |= datagram.EXTENDED
    if frame.remote:
        can_id |= datagram.REMOTE
    if frame.error:
        can_id |= datagram.ERROR
    return datagram.FrameRecord(frame.arrival_ns, can_id, frame.own_echo, bytes(frame.data))


def frame_of(record: datagram.FrameRecord) -> Frame:
    """Frame of the core from one of a datagram."""
    can_id = record.can_id
    return Frame(
        can_id & datagram.ID_MASK,
        record.data,
        record.arrival_ns,
        extended=can_id & datagram.EXTENDED != 0,
        remote=can_id & datagram.REMOTE != 0,
        error=can_id & datagram.ERROR != 0,
        own_echo=record.own_echo,
    )
