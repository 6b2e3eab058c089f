"""Steps of a scenario: a class for each fault; `FAULTS` is the whole list.

Names in a scenario: nodes, messages, signals and controllers that the protocol has.
"""

from collections.abc import Mapping
from typing import Annotated

from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from vcu_gateway.core.codec import Codec
from vcu_gateway.core.commands import message_name
from vcu_gateway.core.demand import CONTROLLERS, PowerMode
from vcu_gateway.core.receive import OWN_NODE
from vcu_gateway.core.spec import ProtocolSpec, SignalSpec
from vcu_gateway.demand_ranges import POWER_LIMIT_HIGHEST_W, SPEED_LIMIT_HIGHEST_RPM
from vcu_gateway.errors import did_you_mean
from vcu_gateway.simulator import faults
from vcu_gateway.simulator.faults import Fault
from vcu_gateway.simulator.nodes import Transform
from vcu_gateway.strict_yaml.validation import Section, refusal
from vcu_gateway.units import NS_PER_MS

PROTOCOL = "protocol"
"""Key of the validation's context; it holds the ProtocolSpec that names must be in."""


def protocol_of(info: ValidationInfo) -> ProtocolSpec:
    protocol: ProtocolSpec = (info.context or {})[PROTOCOL]
    return protocol


def _one_of(name: str, known: list[str], what: str) -> str:
    if name not in known:
        near = did_you_mean(name, known)
        raise refusal(f"must be {what}", near or f"these are {', '.join(known)}")
    return name


def _senders(info: ValidationInfo) -> list[str]:
    return [node for node in protocol_of(info).nodes if node != OWN_NODE]


def _sent_messages(info: ValidationInfo) -> list[str]:
    """Names of the messages that every node but the gateway sends, node by node."""
    protocol = protocol_of(info)
    return [message.name for node in _senders(info) for message in protocol.sent_by(node)]


def _node_or_message(name: str, info: ValidationInfo) -> str:
    known = [*_senders(info), *_sent_messages(info)]
    return _one_of(name, known, "a node or a message that it sends")


def _signal(name: str, info: ValidationInfo) -> str:
    protocol = protocol_of(info)
    messages = _sent_messages(info)
    message, _, signal = name.partition(".")
    if message not in messages:
        nearest = did_you_mean(message, messages)
        remedy = nearest or f"the messages are {', '.join(messages)}"
        raise refusal("must be MESSAGE.SIGNAL, such as BMS_Status.SOC", remedy)
    _one_of(signal, list(protocol.message(message).signal_names), f"a signal of {message}")
    return name


def _controller(name: str) -> str:
    return _one_of(name, list(CONTROLLERS), "a motor controller")


Target = Annotated[str, AfterValidator(_node_or_message)]
SignalName = Annotated[str, AfterValidator(_signal)]
Controller = Annotated[str, AfterValidator(_controller)]


def signal_spec(signal: str, protocol: ProtocolSpec) -> SignalSpec:
    message, _, name = signal.partition(".")
    return protocol.message(message).signal(name)


_LONGEST_S = 86_400


class Step(Section):
    """One fault from `at_s` on, seconds after the start."""

    at_s: float = Field(ge=0, le=_LONGEST_S, description="When it begins.")
    for_s: float | None = Field(
        default=None, ge=0.001, le=_LONGEST_S, description="How long it lasts; without it, on."
    )
    fault: str

    def broken(self, codec: Codec) -> Fault:
        raise NotImplementedError

    def sentence(self) -> str:
        """The fault and its parameters, for a person."""
        given = self.model_dump(exclude={"at_s", "for_s", "fault"}, exclude_unset=True)
        return " ".join([self.fault, *(f"{key} {value}" for key, value in given.items())])


class _FrameStep(Step):
    """A fault of frames: all of them, or those of one node or message, or a share of them."""

    of: Target | None = Field(default=None, description="A node or message; without it, all.")
    share_pct: float = Field(default=100.0, ge=0, le=100, description="How many of the frames.")
    seed: int = Field(default=0, description="Of the chance.")

    def broken(self, codec: Codec) -> Fault:
        transform = faults.sometimes(self.share_pct, self.seed, self._transform())
        if self.of is None:
            return Fault(transform)
        sent = [message.name for message in codec.protocol.sent_by(self.of)]
        return Fault(faults.only(sent or [self.of], transform))

    def _transform(self) -> Transform:
        raise NotImplementedError


class Silence(_FrameStep):
    """Nothing is sent."""

    of: Target = Field(description="A node or message.")

    def _transform(self) -> Transform:
        return faults.lost


class Drop(_FrameStep):
    """A share of the frames is lost."""

    share_pct: float = Field(ge=0, le=100, description="How many of the frames.")

    def _transform(self) -> Transform:
        return faults.lost


class Delay(_FrameStep):
    """Frames come later."""

    delay_ms: int = Field(ge=1, le=60_000, description="How much later.")

    def _transform(self) -> Transform:
        return faults.delayed(self.delay_ms)


class Duplicate(_FrameStep):
    """Every frame comes twice."""

    def _transform(self) -> Transform:
        return faults.doubled


class Corrupt(_FrameStep):
    """Bits are wrong."""

    flip_bits: int = Field(default=1, ge=1, le=64, description="How many of a frame.")

    def _transform(self) -> Transform:
        # Which frames and which bits are two chances; one seed must not tie them together.
        return faults.corrupted(self.flip_bits, self.seed + 1)


class Shorten(_FrameStep):
    """Frames carry too few bytes."""

    length_bytes: int = Field(ge=0, le=7, description="How many are left.")

    def _transform(self) -> Transform:
        return faults.shortened(self.length_bytes)


class Set(Step):
    """A signal has a fixed other value."""

    signal: SignalName = Field(description="MESSAGE.SIGNAL.")
    raw: int | None = Field(default=None, description="The code on the wire.")
    value: float | None = Field(default=None, description="Or the value in the signal's unit.")

    @field_validator("raw")
    @classmethod
    def _fits_the_bits(cls, raw: int | None, info: ValidationInfo) -> int | None:
        if raw is not None and "signal" in info.data:
            spec = signal_spec(info.data["signal"], protocol_of(info))
            if not spec.raw_lowest <= raw <= spec.raw_highest:
                raise refusal(f"must be a code of {spec.raw_lowest} to {spec.raw_highest}")
        return raw

    @field_validator("value")
    @classmethod
    def _instead_of_raw(cls, value: float | None, info: ValidationInfo) -> float | None:
        if "raw" not in info.data or "signal" not in info.data:
            return value  # wrong already
        if value is None and info.data["raw"] is None:
            raise refusal("or raw must be given", "add one of them")
        if value is None:
            return None
        if info.data["raw"] is not None:
            raise refusal("must not stand beside raw", "keep one of them")
        spec = signal_spec(info.data["signal"], protocol_of(info))
        if not spec.raw_lowest <= _code(spec, value) <= spec.raw_highest:
            ends = sorted(
                raw * spec.factor + spec.offset for raw in (spec.raw_lowest, spec.raw_highest)
            )
            raise refusal(f"must be {ends[0]:g} to {ends[1]:g} {spec.unit}".rstrip())
        return value

    def broken(self, codec: Codec) -> Fault:
        spec = signal_spec(self.signal, codec.protocol)
        raw = _code(spec, self.value) if self.raw is None and self.value is not None else self.raw
        return _of_signal(self.signal, faults.overridden(spec, raw or 0))


def _code(spec: SignalSpec, value: float) -> int:
    return round((value - spec.offset) / spec.factor)


def _of_signal(signal: str, transform: Transform) -> Fault:
    return Fault(faults.only([signal.partition(".")[0]], transform))


class Shift(Step):
    """A signal is too high or too low by a constant."""

    signal: SignalName = Field(description="MESSAGE.SIGNAL, such as PCU1_Status2.MotorSpeed.")
    by: float = Field(description="Added to the value, in the signal's unit; may be negative.")

    @field_validator("by")
    @classmethod
    def _within_the_signal(cls, by: float, info: ValidationInfo) -> float:
        if "signal" in info.data:
            spec = signal_spec(info.data["signal"], protocol_of(info))
            most = abs((spec.raw_highest - spec.raw_lowest) * spec.factor)
            if not -most <= by <= most:
                raise refusal(f"must be -{most:g} to {most:g} {spec.unit}".rstrip())
        return by

    def broken(self, codec: Codec) -> Fault:
        spec = signal_spec(self.signal, codec.protocol)
        return _of_signal(self.signal, faults.shifted(spec, round(self.by / spec.factor)))


class Freeze(Step):
    """A signal keeps its first value."""

    signal: SignalName = Field(description="MESSAGE.SIGNAL, such as BMS_Status.LifeSignal.")

    def broken(self, codec: Codec) -> Fault:
        return _of_signal(self.signal, faults.frozen(signal_spec(self.signal, codec.protocol)))


class _ControllerStep(Step):
    """A fault of one controller or both."""

    controller: Controller | None = Field(default=None, description="Without it, both.")

    @property
    def controllers(self) -> tuple[str, ...]:
        return CONTROLLERS if self.controller is None else (self.controller,)


class WrongDirection(_ControllerStep):
    """Forwards is reverse and reverse is forwards, and the speed is counted below 0."""

    def broken(self, codec: Codec) -> Fault:
        messages = [f"{name}_Status2" for name in self.controllers]
        speed = codec.protocol.message(messages[0]).signal("MotorSpeed")
        return Fault(
            faults.only(messages, faults.negated(speed)), faults.turned_round(self.controllers)
        )


class IgnoreCommands(_ControllerStep):
    """Commands are ignored: the last one stays in effect, or a given throttle."""

    throttle_pct: float | None = Field(
        default=None, ge=0, le=100, description="Of the order obeyed; without it, as it was."
    )

    def broken(self, _: Codec) -> Fault:
        return Fault(change=faults.ignoring(self.controllers, self.throttle_pct))


class Slippery(_ControllerStep):
    """The road is slippery under a motor's wheel or both."""

    friction: float = Field(ge=0.05, le=1.2, description="Of tyre and road: ice 0.1, dry 0.9.")

    def broken(self, _: Codec) -> Fault:
        return Fault(change=faults.slippery(self.controllers, self.friction))


class ForeignSender(Step):
    """Another node commands a controller too."""

    controller: Controller = Field(description="The one that is commanded.")
    period_ms: int = Field(default=50, ge=1, le=60_000, description="Between two frames.")
    throttle_pct: float = Field(default=0.0, ge=0, le=100, description="What it asks for.")

    def broken(self, codec: Codec) -> Fault:
        command = codec.by_name[message_name(self.controller)]
        values = {"PowerMode": PowerMode.NORMAL, "Throttle": self.throttle_pct}
        limits = {"SpeedLimit": SPEED_LIMIT_HIGHEST_RPM, "PowerLimit": POWER_LIMIT_HIGHEST_W}
        return Fault(
            foreign_node=faults.ForeignNode(
                command.spec.can_id,
                command.encode({**values, **limits}),
                command.spec.name,
                self.period_ms * NS_PER_MS,
            )
        )


FAULTS: Mapping[str, type[Step]] = {
    "silence": Silence,
    "drop": Drop,
    "delay": Delay,
    "duplicate": Duplicate,
    "corrupt": Corrupt,
    "shorten": Shorten,
    "set": Set,
    "shift": Shift,
    "freeze": Freeze,
    "wrong_direction": WrongDirection,
    "ignore_commands": IgnoreCommands,
    "slippery": Slippery,
    "foreign_sender": ForeignSender,
}
"""Every fault that a step can name."""
