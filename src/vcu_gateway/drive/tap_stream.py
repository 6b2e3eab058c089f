"""Tap stream: frames and core lines of a tapped gateway, batch by batch, with its checkpoints."""

from typing import NamedTuple

from vcu_gateway.core.j1939 import Frame
from vcu_gateway.drive import checkpoint
from vcu_gateway.drive.core_lines import LineWriter
from vcu_gateway.drive.records import Checkpoint, WhyRecord
from vcu_gateway.drive.tap import TappedGateway


class Batch(NamedTuple):
    """Frames and the core lines that belong to them; `lines` may begin with a checkpoint."""

    frames: list[Frame]
    lines: str


class TapStream:
    """What a recording is made of; used by the ticking thread, after its ticks.

    A recording begins with `begin`, and again after whatever could not be recorded. In between a
    batch is taken after each tick.

    Attributes:
        frames: since the start of the gateway, up to the last batch.
        segment_frames: since the last checkpoint.
    """

    def __init__(self, gateway: TappedGateway) -> None:
        self._gateway = gateway
        self._writer = LineWriter()
        self._head = ""
        self._why: object = None
        self.frames = 0

    @property
    def segment_frames(self) -> int:
        return self._writer.frames

    def begin(self, now_ns: int, wall_ns: int) -> None:
        """Begin a segment with the gateway's state; what was not taken before is part of it."""
        self.skip()
        gateway, why = self._gateway, self._gateway.why(now_ns)
        self._head = self._writer.begin(
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

    def batch(self) -> Batch:
        frames, calls = self._gateway.tap.take()
        self.frames += len(frames)
        head, self._head = self._head, ""
        return Batch(frames, head + self._writer.lines(calls, len(frames)))

    def skip(self) -> int:
        """Leave out everything since the last batch; how many frames that were."""
        frames = len(self._gateway.tap.take().frames)
        self.frames += frames
        return frames
