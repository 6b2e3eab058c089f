"""Core lines: a line of JSON for each call and what it answered, written and read.

    {"f":0,"offer":{"source":"driver",...},"now":1000950000000,"granted":true}
    {"f":9,"tick":1001000000000,"frames":[["PCU1","0008A7D0","0c000000e02e0000"],...],"ok":[true,true]}

`f` is the number of frames of the segment before the call. The table of the keys is in
docs/recordings-format.md; both ways are here.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from vcu_gateway.core.calls import NoteSent
from vcu_gateway.core.causes import Event
from vcu_gateway.core.demand import GRANTED, Refusal, RequestResult, refused
from vcu_gateway.core.gateway import CoreCall, TickResult
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.recording.call_text import (
    WORDS,
    call_of,
    call_text,
    encoded,
    event_of,
    event_values,
    out_frame_of,
    out_frame_text,
    settings_json,
    settings_of,
    text_of,
    truth_of,
    whole_of,
)
from vcu_gateway.recording.datagram import CoreLineError


class Checkpoint(NamedTuple):
    """State of the core with which a segment begins.

    Attributes:
        state: for `checkpoint.restore`.
        mode, why: operating mode and its explanation then.
        now_ns, wall_ns: both clocks, read together.
        ticks, frames: since the start of the gateway.
    """

    state: Mapping[str, Any]
    settings: Settings
    mode: Mode
    why: str
    now_ns: int
    wall_ns: int
    ticks: int
    frames: int


class InputRecord(NamedTuple):
    """A call other than a tick; `answer` is None where it has none."""

    input: CoreCall[object]
    answer: RequestResult | None


class FrameRun(NamedTuple):
    """Frames that came one after the other, without another call between them."""

    frames: list[Frame]


class TickRecord(NamedTuple):
    """A tick and its result; how the bus took the frames follows as `NoteSent`."""

    now_ns: int
    frames: tuple[OutFrame, ...]
    mode: Mode
    events: tuple[Event, ...]


class WhyRecord(NamedTuple):
    """Sentence of `Gateway.why(now_ns)`, asked at this place; kept where it says something new."""

    now_ns: int
    sentence: str


class ShellEvent(NamedTuple):
    """Event that the core does not know of: the shell's, around it."""

    now_ns: int
    event: Event


class Gap(NamedTuple):
    """What is missing at this place: a checkpoint follows, with a state from behind it.

    A count is None where it is not known.
    """

    frames: int | None
    ticks: int | None
    datagrams: int | None
    why: str


CoreRecord = Checkpoint | InputRecord | TickRecord | WhyRecord | ShellEvent | Gap
"""What one core line says, in the order in which it happened."""


class NotedCall(NamedTuple):
    """One call of the core in the order of the calls, or what was noted beside them.

    `frames_before` are those since the last take of the tap; `answer` is None where it has none.
    """

    frames_before: int
    what: CoreCall[object] | WhyRecord | ShellEvent
    answer: object = None


class LineWriter:
    """Writes the lines of one segment after the other; `frames` are those of this one so far."""

    def __init__(self) -> None:
        self.frames = 0
        self._mode: Mode | None = None

    def begin(self, checkpoint: Checkpoint) -> str:
        self.frames, self._mode = 0, checkpoint.mode
        values = {name.removesuffix("_ns"): one for name, one in checkpoint._asdict().items()}
        values |= {"settings": settings_json(checkpoint.settings), "mode": checkpoint.mode.value}
        return f'{{"checkpoint":{encoded(values)},"f":0}}\n'

    def lines(self, calls: Sequence[NotedCall], frames: int) -> str:
        """The lines of these calls, `frames` frames with them."""
        lines: list[str] = []
        index, before = 0, self.frames
        while index < len(calls):
            call = calls[index]
            index += 1
            if isinstance(call.answer, TickResult):
                following = calls[index : index + len(call.answer.frames)]
                sent = _sent_behind(call, call.answer, following)
                lines.append(self._tick(before + call.frames_before, call.answer, sent))
                index += len(sent)
            else:
                lines.append(_line(call, before))
        self.frames += frames
        return "".join(lines)

    def _tick(self, frames_before: int, result: TickResult, sent: Sequence[NoteSent]) -> str:
        frames = ",".join(map(out_frame_text, result.frames))
        text = f'{{"f":{frames_before},"tick":{result.snapshot.now_ns},"frames":[{frames}]'
        if sent:
            text += f',"ok":[{",".join(WORDS[one.ok] for one in sent)}]'
        if result.mode is not self._mode:
            self._mode = result.mode
            text += f',"mode":"{result.mode.value}"'
        if result.events:
            text += f',"events":{encoded(list(map(event_values, result.events)))}'
        return text + "}\n"


def _sent_behind(
    tick: NotedCall, result: TickResult, following: Sequence[NotedCall]
) -> list[NoteSent]:
    """Calls of `sent` that follow a tick as the loop makes them; none where they differ."""
    sent = [
        call.what
        for call, frame in zip(following, result.frames, strict=False)
        if isinstance(call.what, NoteSent)
        and call.what.frame is frame
        and call.what.now_ns == result.snapshot.now_ns
        and call.frames_before == tick.frames_before
    ]
    return sent if len(sent) == len(result.frames) else []


def _line(call: NotedCall, before: int) -> str:
    what, result, answer = call.what, call.answer, ""
    if isinstance(what, WhyRecord):
        text = f'"why":{encoded(what.sentence)},"now":{what.now_ns}'
    elif isinstance(what, ShellEvent):
        text = f'"event":{encoded(event_values(what.event))},"now":{what.now_ns}'
    else:
        text = call_text(what)
    if isinstance(result, RequestResult):
        answer = ',"granted":true'
        if result.refusal is not None:
            answer = f',"refused":{encoded([result.refusal.value, result.sentence])}'
    return f'{{"f":{before + call.frames_before},{text}{answer}}}\n'


class Placed(NamedTuple):
    """A record and how many frames of its segment stand before it."""

    frames_before: int
    record: CoreRecord


class LineParser:
    """Reads the lines of one segment after the other."""

    def __init__(self) -> None:
        self._mode = Mode.STARTING

    def records(self, line: bytes | str) -> list[Placed]:
        """Records of one line, each `sent` call after its tick; CoreLineError where it is none.

        A line of a kind that is not known has none.
        """
        try:
            return self._records(json.loads(line))
        except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError) as e:
            what = f"{type(e).__name__}: {e}".removesuffix(": ")
            text = line.decode(errors="replace") if isinstance(line, bytes) else line
            raise CoreLineError(f"is no core line ({what}): {text.strip():.60}") from e

    def _records(self, values: Any) -> list[Placed]:
        before = whole_of(values["f"])
        if "tick" in values and "frames" in values:
            tick, taken = self._tick(values), values.get("ok", ())
            if taken and len(taken) != len(tick.frames):
                raise ValueError(f"{len(taken)} results of {len(tick.frames)} frames")
            pairs = zip(tick.frames, taken, strict=False)
            sent = [NoteSent(frame, truth_of(ok), tick.now_ns) for frame, ok in pairs]
            return [Placed(before, tick), *[Placed(before, InputRecord(one, None)) for one in sent]]
        if (call := call_of(values)) is not None:
            return [Placed(before, InputRecord(call, _read_answer(values)))]
        kind = next((key for key in values if key in _RECORDS), None)
        if kind is None:
            return []  # the recorder's own, or a later version's
        record = _RECORDS[kind](values)
        if isinstance(record, Checkpoint):
            self._mode = record.mode
        return [Placed(before, record)]

    def _tick(self, values: Mapping[str, Any]) -> TickRecord:
        if "mode" in values:
            self._mode = Mode(values["mode"])
        frames = tuple([out_frame_of(one) for one in values["frames"]])
        events = tuple([event_of(one) for one in values.get("events", ())])
        return TickRecord(whole_of(values["tick"]), frames, self._mode, events)


def _read_answer(values: Mapping[str, Any]) -> RequestResult | None:
    if "granted" in values:
        return GRANTED
    if "refused" not in values:
        return None
    code, sentence = values["refused"]
    return refused(Refusal(code), sentence)


def _checkpoint(values: Any) -> Checkpoint:
    kept = values["checkpoint"]
    settings, mode, why = settings_of(kept["settings"]), Mode(kept["mode"]), text_of(kept["why"])
    numbers = [whole_of(kept[key]) for key in ("now", "wall", "ticks", "frames")]
    return Checkpoint(kept["state"], settings, mode, why, *numbers)


def _gap(values: Any) -> Gap:
    gap = values["gap"]
    return Gap(gap.get("frames"), gap.get("ticks"), gap.get("datagrams"), str(gap.get("why", "")))


_RECORDS: Mapping[str, Callable[[Any], CoreRecord]] = {
    "checkpoint": _checkpoint,
    "gap": _gap,
    "why": lambda values: WhyRecord(whole_of(values["now"]), text_of(values["why"])),
    "event": lambda values: ShellEvent(whole_of(values["now"]), event_of(values["event"])),
}
