"""Core lines written: the calls that a tap gathered, a line of JSON each.

    {"f":0,"offer":{"source":"driver",...},"now":1000950000000,"granted":true}
    {"f":9,"tick":1001000000000,"frames":[["PCU1","0008A7D0","0c000000e02e0000"],...],"ok":[true,true]}

`f` is the number of frames of the segment before the call. The table of the keys is in
docs/recordings-format.md; `core_line_parser` reads them.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from vcu_gateway.core import inputs
from vcu_gateway.core.demand import RequestResult
from vcu_gateway.core.events import Event
from vcu_gateway.core.gateway import TickResult
from vcu_gateway.core.inputs import CoreInput, SentInput, TickInput
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.drive.records import Checkpoint, ShellEvent, WhyRecord
from vcu_gateway.drive.settings_json import demand_text, settings_json

_ENCODER = json.JSONEncoder(separators=(",", ":"), allow_nan=False, default=str)


class CoreCall(NamedTuple):
    """One call of the core in the order of the calls, or what was noted beside them.

    Attributes:
        frames_before: frames since the last take of the tap.
        what: the call; frames are not among them.
        answer: the call's result; None where it has none.
    """

    frames_before: int
    what: CoreInput | WhyRecord | ShellEvent
    answer: RequestResult | TickResult | None = None


class LineWriter:
    """Writes the lines of one segment after the other.

    Attributes:
        frames: frames of this segment so far.
    """

    def __init__(self) -> None:
        self.frames = 0
        self._mode: Mode | None = None

    def begin(self, checkpoint: Checkpoint) -> str:
        """The first line of a segment."""
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

    def lines(self, calls: Sequence[CoreCall], frames: int) -> str:
        """The lines of these calls, `frames` frames with them."""
        lines: list[str] = []
        index, before = 0, self.frames
        while index < len(calls):
            call = calls[index]
            index += 1
            if isinstance(call.what, TickInput):
                sent = self._sent(calls, index, call.what.now_ns)
                lines.append(self._tick(call, call.what.now_ns, before, sent))
                index += len(sent)
            else:
                lines.append(_line(call, before))
        self.frames += frames
        return "".join(lines)

    @staticmethod
    def _sent(calls: Sequence[CoreCall], index: int, now_ns: int) -> list[SentInput]:
        """Calls of `sent` that follow a tick as the loop makes them; none where they differ."""
        tick = calls[index - 1]
        decided = tick.answer.frames if isinstance(tick.answer, TickResult) else ()
        following = calls[index : index + len(decided)]
        sent = [
            call.what
            for call, frame in zip(following, decided, strict=False)
            if isinstance(call.what, SentInput)
            and call.what.frame is frame
            and call.what.now_ns == now_ns
            and call.frames_before == tick.frames_before
        ]
        return sent if len(sent) == len(decided) else []

    def _tick(self, call: CoreCall, now_ns: int, before: int, sent: Sequence[SentInput]) -> str:
        result = call.answer
        parts = [f'{{"f":{before + call.frames_before},"tick":{now_ns}']
        if not isinstance(result, TickResult):  # the tick did not come to its end
            return parts[0] + "}\n"
        texts = [_out_frame(frame) for frame in result.frames]
        parts.append(f'"frames":[{",".join(texts)}]')
        if sent:
            parts.append(f'"ok":[{",".join(_TRUTH[one.ok] for one in sent)}]')
        if result.mode is not self._mode:
            self._mode = result.mode
            parts.append(f'"mode":"{result.mode.value}"')
        if result.events:
            parts.append(f'"events":{encoded([_event(event) for event in result.events])}')
        return ",".join(parts) + "}\n"


_TRUTH = {True: "true", False: "false"}


def encoded(values: Any) -> str:
    """JSON text."""
    return _ENCODER.encode(values)


def _out_frame(frame: Any) -> str:
    return f'["{frame.controller}","{frame.can_id:08X}","{frame.data.hex()}"]'


def _event(event: Event) -> list[Any]:
    return [event.name, event.severity.name.lower(), event.fields]


def _line(call: CoreCall, before: int) -> str:
    text = _TEXTS[type(call.what)](call.what)
    answer = "" if call.answer is None else _answer(call.answer)
    return f'{{"f":{before + call.frames_before},{text}{answer}}}\n'


def _answer(answer: Any) -> str:
    if answer.granted:
        return ',"granted":true'
    return f',"refused":{encoded([answer.refusal.value, answer.sentence])}'


def _opened(one: Any) -> str:
    carrier = None if one.carrier is None else list(one.carrier)
    link = [one.link.state.value, one.link.since_ns]
    return f'"link_opened":{encoded(link)},"carrier":{encoded(carrier)},"now":{one.now_ns}'


_Writer = Callable[[Any], str]
_TEXTS: Mapping[type, _Writer] = {
    inputs.LinkLostInput: lambda one: f'"link_lost":{one.at_ns}',
    inputs.LinkOpenedInput: _opened,
    inputs.CarrierInput: lambda one: f'"carrier_changed":{encoded(list(one.carrier))}',
    inputs.RestartsInput: lambda one: f'"restarted":{one.unexpectedly}',
    inputs.BeginInput: lambda one: (
        f'"begin_from":{encoded(one.cut_reason)},"reverse":{encoded(dict(one.reverse))}'
    ),
    inputs.RestartStateInput: lambda one: f'"restart_state":{encoded(one.failure)}',
    inputs.OfferInput: lambda one: (
        f'"offer":{demand_text(one.demand, one.now_ns)},"now":{one.now_ns}'
    ),
    inputs.EndDemandInput: lambda one: f'"end_demand":{encoded(one.source)},"now":{one.now_ns}',
    inputs.ArmInput: lambda one: f'"arm":{one.now_ns}',
    inputs.DisarmInput: lambda one: f'"disarm":{one.now_ns}',
    inputs.ResetInput: lambda one: f'"reset":"{one.level.value}","now":{one.now_ns}',
    inputs.EmergencyStopInput: lambda _: '"estop":true',
    inputs.TerminateInput: lambda _: '"terminate":true',
    inputs.ReloadInput: lambda one: f'"reload":{encoded(settings_json(one.settings))}',
    inputs.SentInput: lambda one: (
        f'"sent":{_out_frame(one.frame)},"ok":{_TRUTH[one.ok]},"now":{one.now_ns}'
    ),
    WhyRecord: lambda one: f'"why":{encoded(one.sentence)},"now":{one.now_ns}',
    ShellEvent: lambda one: f'"event":{encoded(_event(one.event))},"now":{one.now_ns}',
}
