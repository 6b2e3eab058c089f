"""Core lines written: the calls that a tap gathered, a line of JSON each.

    {"f":0,"offer":{"source":"driver",...},"now":1000950000000,"granted":true}
    {"f":9,"tick":1001000000000,"frames":[["PCU1","0008A7D0","0c000000e02e0000"],...],"ok":[true,true]}

`f` is the number of frames of the segment before the call. The table of the keys is in
docs/recordings-format.md; `core_line_parser` reads them.
"""

from collections.abc import Sequence
from typing import NamedTuple

from vcu_gateway.core.calls import NoteSent
from vcu_gateway.core.demand import RequestResult
from vcu_gateway.core.gateway import CoreCall, TickResult
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.drive.call_text import (
    TRUTH,
    call_text,
    encoded,
    event_values,
    out_frame_text,
)
from vcu_gateway.drive.records import Checkpoint, ShellEvent, WhyRecord
from vcu_gateway.drive.settings_json import settings_json


class NotedCall(NamedTuple):
    """One call of the core in the order of the calls, or what was noted beside them.

    Attributes:
        frames_before: frames since the last take of the tap.
        what: the call; frames are not among them.
        answer: the call's result, such as a `RequestResult`; None where it has none.
    """

    frames_before: int
    what: CoreCall[object] | WhyRecord | ShellEvent
    answer: object = None


class LineWriter:
    """Writes the lines of one segment after the other.

    Attributes:
        frames: frames of this segment so far.
    """

    def __init__(self) -> None:
        self.frames = 0
        self._mode: Mode | None = None

    def begin(self, checkpoint: Checkpoint) -> str:
        self.frames, self._mode = 0, checkpoint.mode
        values = {
            "state": checkpoint.state,
            "settings": settings_json(checkpoint.settings),
            "mode": checkpoint.mode.value,
            "why": checkpoint.why,
            "now": checkpoint.now_ns,
            "wall": checkpoint.wall_ns,
            "ticks": checkpoint.ticks,
            "frames": checkpoint.frames,
        }
        return f'{{"checkpoint":{encoded(values)},"f":0}}\n'

    def lines(self, calls: Sequence[NotedCall], frames: int) -> str:
        """The lines of these calls, `frames` frames with them."""
        lines: list[str] = []
        index, before = 0, self.frames
        while index < len(calls):
            call = calls[index]
            index += 1
            if isinstance(call.answer, TickResult):
                sent = self._sent(calls, index, call, call.answer)
                lines.append(self._tick(before + call.frames_before, call.answer, sent))
                index += len(sent)
            else:
                lines.append(_line(call, before))
        self.frames += frames
        return "".join(lines)

    @staticmethod
    def _sent(
        calls: Sequence[NotedCall], index: int, tick: NotedCall, result: TickResult
    ) -> list[NoteSent]:
        """Calls of `sent` that follow a tick as the loop makes them; none where they differ."""
        following = calls[index : index + len(result.frames)]
        sent = [
            call.what
            for call, frame in zip(following, result.frames, strict=False)
            if isinstance(call.what, NoteSent)
            and call.what.frame is frame
            and call.what.now_ns == result.snapshot.now_ns
            and call.frames_before == tick.frames_before
        ]
        return sent if len(sent) == len(result.frames) else []

    def _tick(self, frames_before: int, result: TickResult, sent: Sequence[NoteSent]) -> str:
        texts = [out_frame_text(frame) for frame in result.frames]
        parts = [
            f'{{"f":{frames_before},"tick":{result.snapshot.now_ns}',
            f'"frames":[{",".join(texts)}]',
        ]
        if sent:
            parts.append(f'"ok":[{",".join(TRUTH[one.ok] for one in sent)}]')
        if result.mode is not self._mode:
            self._mode = result.mode
            parts.append(f'"mode":"{result.mode.value}"')
        if result.events:
            parts.append(f'"events":{encoded([event_values(event) for event in result.events])}')
        return ",".join(parts) + "}\n"


def _line(call: NotedCall, before: int) -> str:
    what, answer = call.what, ""
    if isinstance(what, WhyRecord):
        text = f'"why":{encoded(what.sentence)},"now":{what.now_ns}'
    elif isinstance(what, ShellEvent):
        text = f'"event":{encoded(event_values(what.event))},"now":{what.now_ns}'
    else:
        text = call_text(what)
    if isinstance(call.answer, RequestResult):
        answer = _answer(call.answer)
    return f'{{"f":{before + call.frames_before},{text}{answer}}}\n'


def _answer(answer: RequestResult) -> str:
    if answer.refusal is None:
        return ',"granted":true'
    return f',"refused":{encoded([answer.refusal.value, answer.sentence])}'
