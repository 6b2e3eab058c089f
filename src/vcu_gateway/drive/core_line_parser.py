"""Core lines read: a line of JSON to its record; the keys are in docs/recordings-format.md."""

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from vcu_gateway.core.calls import NoteSent
from vcu_gateway.core.demand import GRANTED, Refusal, RequestResult, refused
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.drive.call_text import call_of, event_of, out_frame_of, truth_of
from vcu_gateway.drive.records import (
    Checkpoint,
    CoreRecord,
    Gap,
    InputRecord,
    ShellEvent,
    TickRecord,
    WhyRecord,
)
from vcu_gateway.drive.settings_json import settings_of, text_of, whole_of


class LineError(ValueError):
    """A core line is not one of this format; the text says why."""


class Placed(NamedTuple):
    """A record and how many frames of its segment stand before it."""

    frames_before: int
    record: CoreRecord


class LineParser:
    """Reads the lines of one segment after the other."""

    def __init__(self) -> None:
        self._mode = Mode.STARTING

    def records(self, line: bytes | str) -> list[Placed]:
        """Records of one line, the calls of `sent` after their tick; LineError where it is none.

        A line of a kind that is not known has none.
        """
        try:
            return self._records(json.loads(line))
        except (ValueError, KeyError, TypeError, IndexError, AttributeError, RecursionError) as e:
            raise LineError(_reason(e, line)) from e

    def _records(self, values: Any) -> list[Placed]:
        before = whole_of(values["f"])
        if "tick" in values and "frames" in values:
            tick = self._tick(values)
            sent = _sent(tick, values.get("ok", ()))
            return [Placed(before, tick), *[Placed(before, one) for one in sent]]
        call = call_of(values)
        if call is not None:
            return [Placed(before, InputRecord(call, _answer(values)))]
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


def _reason(error: Exception, line: bytes | str) -> str:
    text = line.decode(errors="replace") if isinstance(line, bytes) else line
    what = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"is no core line ({what}): {text.strip():.60}"


def _sent(tick: TickRecord, taken: Any) -> Iterator[InputRecord]:
    if taken and len(taken) != len(tick.frames):
        raise ValueError(f"{len(taken)} results of {len(tick.frames)} frames")
    for frame, ok in zip(tick.frames, taken, strict=False):
        yield InputRecord(NoteSent(frame, truth_of(ok), tick.now_ns), None)


def _answer(values: Mapping[str, Any]) -> RequestResult | None:
    if "granted" in values:
        return GRANTED
    if "refused" not in values:
        return None
    code, sentence = values["refused"]
    return refused(Refusal(code), sentence)


def _checkpoint(values: Any) -> Checkpoint:
    kept = values["checkpoint"]
    return Checkpoint(
        state=kept["state"],
        settings=settings_of(kept["settings"]),
        mode=Mode(kept["mode"]),
        why=text_of(kept["why"]),
        now_ns=whole_of(kept["now"]),
        wall_ns=whole_of(kept["wall"]),
        ticks=whole_of(kept["ticks"]),
        frames=whole_of(kept["frames"]),
    )


def _gap(values: Any) -> Gap:
    gap = values["gap"]
    return Gap(gap.get("frames"), gap.get("ticks"), gap.get("datagrams"), str(gap.get("why", "")))


_RECORDS: Mapping[str, Callable[[Any], CoreRecord]] = {
    "checkpoint": _checkpoint,
    "gap": _gap,
    "why": lambda values: WhyRecord(whole_of(values["now"]), text_of(values["why"])),
    "event": lambda values: ShellEvent(whole_of(values["now"]), event_of(values["event"])),
}
