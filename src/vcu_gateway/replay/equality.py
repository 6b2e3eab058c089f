"""Equality: a drive's inputs replayed with its own configuration must give its results again.

    check = EqualityCheck(codec)
    for record in drive.runs():
        check.note(record)
    check.result()

A segment's checkpoint begins the replay; each later one is compared with the state that the replay
has come to, and taken over where they differ, so that one difference does not hide the next.
"""

import json
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

from vcu_gateway.core.calls import WORDS, NoteSent, RunTick
from vcu_gateway.core.causes import Event
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import RequestResult
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.state import Snapshot
from vcu_gateway.recording import checkpoint
from vcu_gateway.recording.core_lines import (
    Checkpoint,
    CoreRecord,
    FrameRun,
    Gap,
    InputRecord,
    ShellEvent,
    TickRecord,
    WhyRecord,
)
from vcu_gateway.replay.commands import answer_text, field_changes

BUGS = (
    ArithmeticError,
    AssertionError,
    AttributeError,
    LookupError,
    RecursionError,
    TypeError,
    ValueError,
)
"""What a core raises by a bug, or on a state that no gateway wrote."""
_NOTHING = "nothing"


class Difference(NamedTuple):
    """A place where the replay is not the recording.

    Attributes:
        tick: number of the tick since the gateway's start; now_ns: its time on that clock.
        field: such as "PCU1 Throttle", "mode", "why", "answer to arm".
    """

    tick: int
    now_ns: int
    field: str
    recorded: str
    replayed: str


class NotReplayed(NamedTuple):
    """A stretch that is missing in the recording, from the last tick before it.

    Attributes:
        ticks, frames: how many; None where that is not known.
    """

    after_tick: int
    now_ns: int
    ticks: int | None
    frames: int | None
    why: str


class EndedByBug(NamedTuple):
    """Tick in which the gateway's process ended by a bug.

    Attributes:
        error: what the replay ended with; None where it decided.
    """

    tick: int
    now_ns: int
    error: str | None


class Equality(NamedTuple):
    """Result of a check, with the names and the order of the verb's JSON.

    Attributes:
        began_ns, ended_ns: first and last tick.
        ticks, equal_ticks, frames, answers, why_sentences, checkpoints: how many were compared.
        first_difference: None where there is none; differences: how many, by field.
        ended_by_bug: the last tick, where it was the end of the gateway's process.
        not_replayed: gaps of the recording.
    """

    began_ns: int
    ended_ns: int
    ticks: int
    equal_ticks: int
    frames: int
    answers: int
    why_sentences: int
    checkpoints: int
    first_difference: Difference | None
    differences: dict[str, int]
    ended_by_bug: EndedByBug | None
    not_replayed: tuple[NotReplayed, ...]

    @property
    def equal(self) -> bool:
        return self.first_difference is None


class EqualityCheck:
    """Replay of records in their order, each result compared with the recorded one.

    It begins with `gateway`, where the drive begins as a gateway does; else, and after every gap,
    with the recorded state. `observe` is given the snapshot of each tick.
    """

    def __init__(
        self,
        codec: Codec,
        gateway: Gateway | None = None,
        observe: Callable[[Snapshot], None] = lambda _: None,
    ) -> None:
        self._observe = observe
        self._codec = codec
        self._new_gateway = gateway
        self._gateway: Gateway | None = None
        self._first: Difference | None = None
        self._counts: Counter[str] = Counter()
        self._compared: Counter[str] = Counter()
        self._gaps: list[NotReplayed] = []
        self._ended_by_bug: EndedByBug | None = None
        self._tick = 0
        self._equal_ticks = 0
        self._tick_open = self._tick_differs = False
        self._began_ns: int | None = None
        self._now_ns = 0
        self._why: tuple[object, ...] | None = None
        self._why_open = False
        self._unsaid: str | None = None

    @property
    def is_different(self) -> bool:
        """Whether a difference was found so far."""
        return self._first is not None

    def note(self, record: FrameRun | CoreRecord) -> None:
        gateway = self._gateway
        if self._why_open and not isinstance(record, ShellEvent) and not _is_sent(record):
            self._look_at_why()
        if isinstance(record, Checkpoint):
            self._checkpoint(record)
        elif isinstance(record, Gap):
            self._gap(record)
        elif gateway is None:
            return
        elif isinstance(record, FrameRun):
            self._receive(gateway, record.frames)
        else:
            self._replay(gateway, record)

    def _replay(self, gateway: Gateway, record: CoreRecord) -> None:
        if isinstance(record, InputRecord):
            self._input(gateway, record)
        elif isinstance(record, TickRecord):
            self._replay_tick(gateway, record)
        elif isinstance(record, WhyRecord):
            self._explain(gateway, record)

    def _receive(self, gateway: Gateway, frames: list[Frame]) -> None:
        receive = gateway.receive
        for frame in frames:
            receive(frame)
        self._compared["frames"] += len(frames)

    def _input(self, gateway: Gateway, record: InputRecord) -> None:
        one = record.input
        if type(one) is RunTick:
            self._last_tick(gateway, one.now_ns)
            return
        answer = one.apply(gateway)
        if record.answer is not None and isinstance(answer, RequestResult):
            self._compared["answers"] += 1
            if answer != record.answer:
                what = f"answer to {WORDS[type(one)]}"
                self._differs(what, answer_text(record.answer), answer_text(answer))

    def _begin_tick(self, now_ns: int) -> None:
        self._end_tick()
        self._now_ns = now_ns
        if self._began_ns is None:
            self._began_ns = now_ns
        self._tick_open = True
        self._tick += 1
        self._compared["ticks"] += 1

    def _replay_tick(self, gateway: Gateway, record: TickRecord) -> None:
        self._begin_tick(record.now_ns)
        result = gateway.tick(record.now_ns)
        self._observe(result.snapshot)
        if result.frames != record.frames:
            for change in field_changes(self._codec, record.frames, result.frames):
                field = f"{change.controller} {change.field}"
                self._differs(field, change.before, change.after)
        if result.mode is not record.mode:
            self._differs("mode", record.mode.value, result.mode.value)
        if result.events or record.events:
            self._compare_events(record, result)
        self._why_open = True

    def _last_tick(self, gateway: Gateway, now_ns: int) -> None:
        """A tick that was the end of the gateway's process has no result; nor may it have now."""
        self._begin_tick(now_ns)
        error: str | None = None
        try:
            gateway.tick(now_ns)
        except BUGS as bug:
            error = f"{type(bug).__name__}: {bug}"
        else:
            self._differs("tick", "ended the gateway's process by a bug", "decided")
        self._ended_by_bug = EndedByBug(self._tick, now_ns, error)
        self._gateway = None

    def _look_at_why(self) -> None:
        """The loop explains a tick when its frames have left; a sentence follows what is new."""
        self._why_open = False
        if self._gateway is None:
            return
        signature = self._gateway.reasons(self._now_ns).signature()
        if signature != self._why:
            known, self._why = self._why is not None, signature
            self._unsaid = self._gateway.why(self._now_ns).sentence() if known else None

    def _end_tick(self) -> None:
        """The tick before and all that belongs to it was compared."""
        if self._why_open:
            self._look_at_why()
        if self._unsaid is not None:
            self._differs("why", _NOTHING, self._unsaid)
            self._unsaid = None
        self._equal_ticks += self._tick_open and not self._tick_differs
        self._tick_open = self._tick_differs = False

    def _compare_events(self, record: TickRecord, result: TickResult) -> None:
        recorded, replayed = _events(record.events), _events(result.events)
        if recorded == replayed:
            return
        missing = [one for one in recorded if one not in replayed]
        added = [one for one in replayed if one not in recorded]
        told = "; ".join(missing) or _NOTHING, "; ".join(added) or _NOTHING
        self._differs(
            "events", *(told if missing or added else ("; ".join(recorded), "; ".join(replayed)))
        )

    def _explain(self, gateway: Gateway, record: WhyRecord) -> None:
        self._compared["why_sentences"] += 1
        self._unsaid = None
        sentence = gateway.why(record.now_ns).sentence()
        if sentence != record.sentence:
            self._differs("why", record.sentence, sentence)

    def _checkpoint(self, record: Checkpoint) -> None:
        if self._gateway is not None:
            self._end_tick()
            self._compared["checkpoints"] += 1
            state = json.loads(json.dumps(checkpoint.state_of(self._gateway)))
            path = first_difference(record.state, state)
            if path is None and record.ticks == self._tick:
                return
            field, recorded, replayed = path or ("ticks", str(record.ticks), str(self._tick))
            self._differs(f"checkpoint {field}", recorded, replayed)
        new, self._new_gateway = self._new_gateway, None
        self._gateway = new or checkpoint.restore(record.state, self._codec, record.settings)
        self._tick, self._now_ns, self._why = record.ticks, record.now_ns, None

    def _gap(self, record: Gap) -> None:
        self._unsaid = None
        self._end_tick()
        gap = NotReplayed(self._tick, self._now_ns, record.ticks, record.frames, record.why)
        self._gaps.append(gap)
        self._gateway = None

    def _differs(self, field: str, recorded: str, replayed: str) -> None:
        self._tick_differs = True
        self._counts[field] += 1
        if self._first is None:
            self._first = Difference(self._tick, self._now_ns, field, recorded, replayed)

    def result(self) -> Equality:
        """What was found; the end of the records."""
        self._end_tick()
        counts = ("ticks", "frames", "answers", "why_sentences", "checkpoints")
        return Equality(
            began_ns=self._began_ns or 0,
            ended_ns=self._now_ns,
            equal_ticks=self._equal_ticks,
            **{name: self._compared[name] for name in counts},
            first_difference=self._first,
            differences=dict(self._counts),
            ended_by_bug=self._ended_by_bug,
            not_replayed=tuple(self._gaps),
        )


def _is_sent(record: FrameRun | CoreRecord) -> bool:
    return isinstance(record, InputRecord) and isinstance(record.input, NoteSent)


def _events(events: tuple[Event, ...]) -> list[str]:
    """Events as they stand in a core line, so that both sides have JSON's types."""
    return [
        f"{one.name} {json.dumps(dict(one.fields), sort_keys=True, default=str)}" for one in events
    ]


def first_difference(recorded: Any, replayed: Any, path: str = "") -> tuple[str, str, str] | None:
    """Path and both values of the first place where two JSON values differ."""
    if isinstance(recorded, dict) and isinstance(replayed, dict):
        keys = [*recorded, *(key for key in replayed if key not in recorded)]
        pairs = [(key, recorded.get(key), replayed.get(key)) for key in keys]
    elif (
        isinstance(recorded, list) and isinstance(replayed, list) and len(recorded) == len(replayed)
    ):
        pairs = [(str(i), *both) for i, both in enumerate(zip(recorded, replayed, strict=True))]
    else:
        return None if recorded == replayed else (path, _short(recorded), _short(replayed))
    for key, one, other in pairs:
        if one != other:
            return first_difference(one, other, f"{path}.{key}" if path else key)
    return None


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 120 else text[:119] + "…"
