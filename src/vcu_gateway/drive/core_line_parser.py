"""Core lines read: a line of JSON to its record; the keys are in docs/recordings-format.md."""

import json
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

from vcu_gateway.core import inputs
from vcu_gateway.core.demand import GRANTED, Refusal, RequestResult, refused
from vcu_gateway.core.events import Event, Severity
from vcu_gateway.core.inputs import SentInput
from vcu_gateway.core.link import Carrier, LinkState, LinkStatus
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.drive.records import (
    Checkpoint,
    CoreRecord,
    Gap,
    InputRecord,
    ShellEvent,
    TickRecord,
    WhyRecord,
)
from vcu_gateway.drive.settings_json import demand_of, settings_of


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
        before = _number(values["f"])
        if "tick" in values and "frames" not in values:  # it ended the gateway's process
            return [Placed(before, InputRecord(inputs.TickInput(_number(values["tick"])), None))]
        if "tick" in values:
            tick = self._tick(values)
            sent = _sent(tick, values.get("ok", ()))
            return [Placed(before, tick), *[Placed(before, one) for one in sent]]
        kind = next((key for key in values if key in _INPUTS), None)
        if kind is not None:
            return [Placed(before, InputRecord(_INPUTS[kind](values), _answer(values)))]
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
        frames = tuple([_out_frame(one) for one in values["frames"]])
        events = tuple([_event(one) for one in values.get("events", ())])
        return TickRecord(_number(values["tick"]), frames, self._mode, events)


def _reason(error: Exception, line: bytes | str) -> str:
    text = line.decode(errors="replace") if isinstance(line, bytes) else line
    what = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return f"is no core line ({what}): {text.strip():.60}"


def _sent(tick: TickRecord, taken: Any) -> Iterator[InputRecord]:
    if taken and len(taken) != len(tick.frames):
        raise ValueError(f"{len(taken)} results of {len(tick.frames)} frames")
    for frame, ok in zip(tick.frames, taken, strict=False):
        yield InputRecord(SentInput(frame, _truth(ok), tick.now_ns), None)


def _number(value: Any) -> int:
    if type(value) is not int:
        raise ValueError(f"{value!r:.40} is no whole number")
    return value


def _truth(value: Any) -> bool:
    if not isinstance(value, bool):
        raise ValueError(f"{value!r:.40} is neither true nor false")
    return value


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{value!r:.40} is no text")
    return value


def _text_or_none(value: Any) -> str | None:
    return None if value is None else _text(value)


def _out_frame(values: Any) -> OutFrame:
    controller, can_id, data = values
    return OutFrame(_text(controller), int(can_id, 16), bytes.fromhex(data))


def _event(values: Any) -> Event:
    name, severity, fields = values
    return Event(_text(name), Severity[severity.upper()], dict(fields))


def _answer(values: Mapping[str, Any]) -> RequestResult | None:
    if "granted" in values:
        return GRANTED
    if "refused" not in values:
        return None
    code, sentence = values["refused"]
    return refused(Refusal(code), sentence)


def _carrier(values: Any) -> Carrier | None:
    if values is None:
        return None
    present, since_ns = values
    return Carrier(_truth(present), _number(since_ns))


def _known_carrier(values: Any) -> Carrier:
    carrier = _carrier(values)
    if carrier is None:
        raise ValueError("a change of the carrier without the carrier")
    return carrier


def _link_opened(values: Any) -> inputs.LinkOpenedInput:
    state, since_ns = values["link_opened"]
    link = LinkStatus(LinkState(state), _number(since_ns))
    return inputs.LinkOpenedInput(link, _carrier(values["carrier"]), _number(values["now"]))


def _begin(values: Any) -> inputs.BeginInput:
    reverse = {name: _truth(one) for name, one in values["reverse"].items()}
    return inputs.BeginInput(_text_or_none(values["begin_from"]), reverse)


def _checkpoint(values: Any) -> Checkpoint:
    kept = values["checkpoint"]
    return Checkpoint(
        state=kept["state"],
        settings=settings_of(kept["settings"]),
        mode=Mode(kept["mode"]),
        why=_text(kept["why"]),
        now_ns=_number(kept["now"]),
        wall_ns=_number(kept["wall"]),
        ticks=_number(kept["ticks"]),
        frames=_number(kept["frames"]),
    )


def _gap(values: Any) -> Gap:
    gap = values["gap"]
    return Gap(gap.get("frames"), gap.get("ticks"), gap.get("datagrams"), str(gap.get("why", "")))


_RECORDS: Mapping[str, Callable[[Any], CoreRecord]] = {
    "checkpoint": _checkpoint,
    "gap": _gap,
    "why": lambda values: WhyRecord(_number(values["now"]), _text(values["why"])),
    "event": lambda values: ShellEvent(_number(values["now"]), _event(values["event"])),
}

_INPUTS: Mapping[str, Callable[[Any], inputs.CoreInput]] = {
    "offer": lambda values: inputs.OfferInput(
        demand_of(values["offer"], _number(values["now"])), values["now"]
    ),
    "link_lost": lambda values: inputs.LinkLostInput(_number(values["link_lost"])),
    "link_opened": _link_opened,
    "carrier_changed": lambda values: inputs.CarrierInput(
        _known_carrier(values["carrier_changed"])
    ),
    "restarted": lambda values: inputs.RestartsInput(_number(values["restarted"])),
    "begin_from": _begin,
    "restart_state": lambda values: inputs.RestartStateInput(
        _text_or_none(values["restart_state"])
    ),
    "end_demand": lambda values: inputs.EndDemandInput(
        _text(values["end_demand"]), _number(values["now"])
    ),
    "arm": lambda values: inputs.ArmInput(_number(values["arm"])),
    "disarm": lambda values: inputs.DisarmInput(_number(values["disarm"])),
    "reset": lambda values: inputs.ResetInput(FaultClass(values["reset"]), _number(values["now"])),
    "estop": lambda _: inputs.EmergencyStopInput(),
    "terminate": lambda _: inputs.TerminateInput(),
    "reload": lambda values: inputs.ReloadInput(settings_of(values["reload"])),
    "sent": lambda values: SentInput(
        _out_frame(values["sent"]), _truth(values["ok"]), _number(values["now"])
    ),
}
