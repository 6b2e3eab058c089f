"""Commands of both controllers in a replay: what differs, what was recorded, series for plots."""

import math
from array import array
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from vcu_gateway.core.codec import Codec, MessageCodec
from vcu_gateway.core.commands import message_name
from vcu_gateway.core.demand import CONTROLLERS, RequestResult
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.spec import FRAME_LENGTH_BYTES, SignalSpec
from vcu_gateway.core.transmit import OutFrame, SentValues
from vcu_gateway.recording.decoded import decimals

_PLOTTED = ("Throttle", "Brake", "PowerMode", "MotorReverse", "SpeedLimit", "PowerLimit")


class FieldChange(NamedTuple):
    """One field of a command that is another one.

    Attributes:
        before, after: as a person reads them, with their unit.
        amount: how far they are apart in the field's unit; 1 where that says nothing.
    """

    controller: str
    field: str
    before: str
    after: str
    amount: float


def field_changes(
    codec: Codec, before: tuple[OutFrame, ...], after: tuple[OutFrame, ...]
) -> Iterator[FieldChange]:
    """Every field in which the commands of a tick differ."""
    first, second = _by_controller(before), _by_controller(after)
    for name, message in _command_codecs(codec).items():
        one, other = first.get(name), second.get(name)
        if one is not None and other is not None:
            yield from _different(name, message, one, other)
        elif one is not other:
            yield FieldChange(name, "frame", _sent(one), _sent(other), 1.0)


class RecordedCommands:
    """Recorded commands put into a core's history of what it sent, which judges the echoes.

    A controller's Status1 echoes the recorded command. Held against what another configuration
    would have sent, every difference would look like a controller that does not obey, and stop
    the drive.
    """

    def __init__(self, codec: Codec) -> None:
        self._codecs = _command_codecs(codec)

    def of(self, controller: str, data: bytes | bytearray, at_ns: int) -> SentValues:
        """Throttle and direction of a command that left then."""
        values = _values(self._codecs[controller], data)
        return SentValues(at_ns, values["Throttle"], bool(values["MotorReverse"]))

    def add(self, gateway: Gateway, controller: str, data: bytes | bytearray, at_ns: int) -> None:
        """Beside what the core sent itself."""
        if len(data) == FRAME_LENGTH_BYTES:
            one = self.of(controller, data, at_ns)
            gateway.transmitter.history.frames[controller].append(one)

    def put(self, gateway: Gateway, controller: str, data: bytes, at_ns: int) -> None:
        """Instead of what the core sent last."""
        frames = gateway.transmitter.history.frames[controller]
        if frames and len(data) == FRAME_LENGTH_BYTES:
            frames[-1] = self.of(controller, data, at_ns)


class CommandSeries:
    """Commands of the replayed side for plots: one point a tick, four bytes a value.

    Attributes:
        times_ns: of the ticks, on the gateway's clock.
        values: by message and signal, such as "VCU_PCU1_Command.Throttle"; NaN without a frame.
    """

    def __init__(self, codec: Codec) -> None:
        self.times_ns = array("q")
        self.values: Mapping[str, array[float]] = {
            f"{message_name(name)}.{signal}": array("f")
            for name in CONTROLLERS
            for signal in _PLOTTED
        }
        self._codecs = _command_codecs(codec)

    def add(self, now_ns: int, sent: tuple[OutFrame, ...]) -> None:
        """One tick's commands."""
        self.times_ns.append(now_ns)
        frames = _by_controller(sent)
        for name, codec in self._codecs.items():
            values = _values(codec, frames[name].data) if name in frames else {}
            for signal in _PLOTTED:
                series = self.values[f"{message_name(name)}.{signal}"]
                series.append(values.get(signal, math.nan))


def send(gateway: Gateway, frames: Iterable[OutFrame], now_ns: int) -> None:
    """The bus takes the frames, and they come back."""
    for frame in frames:
        gateway.sent(frame, True, now_ns)
        gateway.receive(Frame(frame.can_id, frame.data, now_ns, own_echo=True))


def answer_text(answer: RequestResult) -> str:
    """The answer to a request in words."""
    return "granted" if answer.granted else f"refused: {answer.sentence}"


def _command_codecs(codec: Codec) -> dict[str, MessageCodec]:
    return {name: codec.by_name[message_name(name)] for name in CONTROLLERS}


def _values(codec: MessageCodec, data: bytes | bytearray) -> dict[str, float]:
    return dict(zip(codec.spec.signal_names, codec.decode(data).values, strict=True))


def _by_controller(frames: tuple[OutFrame, ...]) -> dict[str, OutFrame]:
    return {frame.controller: frame for frame in frames}


def _sent(frame: OutFrame | None) -> str:
    return "none" if frame is None else f"{frame.can_id:08X}#{frame.data.hex()}"


def _different(
    name: str, codec: MessageCodec, one: OutFrame, other: OutFrame
) -> Iterator[FieldChange]:
    if one.can_id != other.can_id:
        yield FieldChange(name, "identifier", f"{one.can_id:08X}", f"{other.can_id:08X}", 1.0)
    if one.data == other.data:
        return
    if len(one.data) != len(other.data) or len(one.data) != FRAME_LENGTH_BYTES:
        yield FieldChange(name, "frame", _sent(one), _sent(other), 1.0)
        return
    found = False
    values = zip(codec.decode(one.data).values, codec.decode(other.data).values, strict=True)
    for signal, (was, is_) in zip(codec.spec.signals, values, strict=True):
        if was != is_:
            found = True
            amount = 1.0 if signal.names else abs(is_ - was)
            yield FieldChange(name, signal.name, _value(signal, was), _value(signal, is_), amount)
    if not found:
        yield FieldChange(name, "reserved bits", one.data.hex(), other.data.hex(), 1.0)


def _value(signal: SignalSpec, value: float) -> str:
    """A value with its unit, or the name of its code."""
    if name := signal.names.get(round(value)):
        return name
    unit = f" {signal.unit}" if signal.unit else ""
    return f"{round(value, decimals(signal)) + 0:g}{unit}"
