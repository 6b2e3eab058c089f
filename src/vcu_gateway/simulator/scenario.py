"""Scenario: faults and their times, read from a file as strictly as the configuration.

A step of it is a class for each fault; `FAULTS` is the whole list. Names in a scenario: nodes,
messages, signals and controllers that the protocol has.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationInfo, field_validator

from vcu_gateway.core.codec import Codec
from vcu_gateway.core.commands import message_name
from vcu_gateway.core.demand import CONTROLLERS, PowerMode
from vcu_gateway.core.receive import OWN_NODE
from vcu_gateway.core.spec import ProtocolSpec, SignalSpec
from vcu_gateway.demand_ranges import POWER_LIMIT_HIGHEST_W, SPEED_LIMIT_HIGHEST_RPM
from vcu_gateway.errors import ConfigError, Problem, did_you_mean
from vcu_gateway.simulator import faults
from vcu_gateway.simulator.faults import Fault, FaultInterval, ForeignNode, Report
from vcu_gateway.simulator.nodes import Transform
from vcu_gateway.simulator.pedals import Foot, FootSection
from vcu_gateway.simulator.vehicle import RESISTANCE_OHM, Vehicle
from vcu_gateway.strict_yaml import file_text, parser, validation
from vcu_gateway.strict_yaml.file_text import FileProblem, KeyPath, problems, shown
from vcu_gateway.strict_yaml.validation import Section, refusal
from vcu_gateway.units import NS_PER_MS, NS_PER_S

PROTOCOL = "protocol"
"""Key of the validation's context; it holds the ProtocolSpec that names must be in."""


def protocol_of(info: ValidationInfo) -> ProtocolSpec:
    protocol: ProtocolSpec = (info.context or {})[PROTOCOL]
    return protocol


def _one_of(name: str, known: list[str], what: str, these: str = "these") -> str:
    if name not in known:
        near = did_you_mean(name, known)
        raise refusal(f"must be {what}", near or f"{these} are {', '.join(known)}")
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
    message, _, signal = name.partition(".")
    what = "MESSAGE.SIGNAL, such as BMS_Status.SOC"
    _one_of(message, _sent_messages(info), what, "the messages")
    signals = protocol_of(info).message(message).signal_names
    _one_of(signal, list(signals), f"a signal of {message}")
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

    def interval(self, codec: Codec, start_ns: int, report: Report) -> FaultInterval:
        """The fault in time, by the name and the parameters that the file gives."""
        given = self.model_dump(exclude={"at_s", "for_s", "fault"}, exclude_unset=True)
        name = " ".join([self.fault, *(f"{key} {value}" for key, value in given.items())])
        begin_ns = start_ns + round(self.at_s * NS_PER_S)
        end_ns = None if self.for_s is None else begin_ns + round(self.for_s * NS_PER_S)
        return FaultInterval(name, self.broken(codec), begin_ns, end_ns, report)


class _FrameStep(Step):
    """A fault of frames: all of them, or those of one node or message, or a share of them.

    They are lost where `_transform` says nothing else.
    """

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
        return lambda _: ()


class Silence(_FrameStep):
    """Nothing is sent."""

    of: Target = Field(description="A node or message.")


class Drop(_FrameStep):
    """A share of the frames is lost."""

    share_pct: float = Field(ge=0, le=100, description="How many of the frames.")


class Delay(_FrameStep):
    """Frames come later."""

    delay_ms: int = Field(ge=1, le=60_000, description="How much later.")

    def _transform(self) -> Transform:
        delay_ns = self.delay_ms * NS_PER_MS
        return lambda frame: (frame._replace(due_ns=frame.due_ns + delay_ns),)


class Duplicate(_FrameStep):
    """Every frame comes twice."""

    def _transform(self) -> Transform:
        return lambda frame: (frame, frame)


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
        return lambda frame: (frame._replace(data=frame.data[: self.length_bytes]),)


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
            raws = spec.raw_lowest, spec.raw_highest
            ends = sorted(raw * spec.factor + spec.offset for raw in raws)
            raise refusal(f"must be {ends[0]:g} to {ends[1]:g} {spec.unit}".rstrip())
        return value

    def broken(self, codec: Codec) -> Fault:
        spec = signal_spec(self.signal, codec.protocol)
        raw = self.raw if self.value is None else _code(spec, self.value)
        return _recoded(self.signal, spec, lambda _: raw or 0)


def _code(spec: SignalSpec, value: float) -> int:
    return round((value - spec.offset) / spec.factor)


def _recoded(signal: str, spec: SignalSpec, code_of: Callable[[int], int]) -> Fault:
    return Fault(faults.only([signal.partition(".")[0]], faults.recoded(spec, code_of)))


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
        lowest, highest, by = spec.raw_lowest, spec.raw_highest, round(self.by / spec.factor)
        return _recoded(self.signal, spec, lambda raw: max(lowest, min(highest, raw + by)))


class Freeze(Step):
    """A signal keeps its first value."""

    signal: SignalName = Field(description="MESSAGE.SIGNAL, such as BMS_Status.LifeSignal.")

    def broken(self, codec: Codec) -> Fault:
        kept: dict[str, int] = {}
        spec = signal_spec(self.signal, codec.protocol)
        return _recoded(self.signal, spec, lambda raw: kept.setdefault(self.signal, raw))


class Swap(Step):
    """Two signals of a message are in each other's place, as with wires that are mixed up."""

    signal: SignalName = Field(description="MESSAGE.SIGNAL, such as Pedals_Position.Throttle1.")
    with_signal: SignalName = Field(description="The other one; its codes must fit both.")

    @field_validator("with_signal")
    @classmethod
    def _alike(cls, other: str, info: ValidationInfo) -> str:
        if "signal" in info.data:
            one, protocol = info.data["signal"], protocol_of(info)
            if one.partition(".")[0] != other.partition(".")[0] or one == other:
                raise refusal(f"must be another signal of {one.partition('.')[0]}")
            if signal_spec(one, protocol).length_bits != signal_spec(other, protocol).length_bits:
                raise refusal(f"must have as many bits as {one}")
        return other

    def broken(self, codec: Codec) -> Fault:
        specs = [signal_spec(name, codec.protocol) for name in (self.signal, self.with_signal)]
        return Fault(faults.only([self.signal.partition(".")[0]], faults.swapped(*specs)))


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
        negated = faults.recoded(speed, lambda raw: -raw)  # in two's complement
        return Fault(faults.only(messages, negated), self._change)

    def _change(self, vehicle: Vehicle, broken: bool) -> None:
        for name in self.controllers:
            vehicle.motors[name].turned_round = broken


class IgnoreCommands(_ControllerStep):
    """Commands are ignored: the last one stays in effect, or a given throttle."""

    throttle_pct: float | None = Field(
        default=None, ge=0, le=100, description="Of the order obeyed; without it, as it was."
    )

    def broken(self, _: Codec) -> Fault:
        return Fault(change=self._change)

    def _change(self, vehicle: Vehicle, broken: bool) -> None:
        for name in self.controllers:
            motor = vehicle.motors[name]
            motor.ignores_commands = broken
            if broken and self.throttle_pct is not None:
                motor.order = motor.order._replace(throttle_pct=self.throttle_pct)


class Slippery(_ControllerStep):
    """The road is slippery under a motor's wheel or both."""

    friction: float = Field(ge=0.05, le=1.2, description="Of tyre and road: ice 0.1, dry 0.9.")

    def broken(self, _: Codec) -> Fault:
        return Fault(change=self._change)

    def _change(self, vehicle: Vehicle, broken: bool) -> None:
        vehicle.slip_on(self.controllers, self.friction if broken else None)


class ForeignSender(Step):
    """Another node commands a controller too."""

    controller: Controller = Field(description="The one that is commanded.")
    period_ms: int = Field(default=50, ge=1, le=60_000, description="Between two frames.")
    throttle_pct: float = Field(default=0.0, ge=0, le=100, description="What it asks for.")

    def broken(self, codec: Codec) -> Fault:
        command = codec.by_name[message_name(self.controller)]
        values = {"PowerMode": PowerMode.NORMAL, "Throttle": self.throttle_pct}
        limits = {"SpeedLimit": SPEED_LIMIT_HIGHEST_RPM, "PowerLimit": POWER_LIMIT_HIGHEST_W}
        data, period_ns = command.encode({**values, **limits}), self.period_ms * NS_PER_MS
        node = ForeignNode(command.spec.can_id, data, command.spec.name, period_ns)
        return Fault(foreign_node=node)


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
    "swap": Swap,
    "wrong_direction": WrongDirection,
    "ignore_commands": IgnoreCommands,
    "slippery": Slippery,
    "foreign_sender": ForeignSender,
}
"""Every fault that a step can name."""

_EXAMPLE = "{at_s: 10, fault: silence, of: BMS}"


class ScenarioStart(Section):
    """The vehicle at the beginning."""

    soc_pct: float = Field(default=80.0, ge=0, le=100, description="State of charge.")
    battery_speedup: float = Field(
        default=1.0, ge=0, le=10_000, description="Factor of its charge and discharge."
    )
    battery_resistance_ohm: float = Field(
        default=RESISTANCE_OHM, ge=0.001, le=0.5, description="Of the pack, from end to end."
    )


class _File(Section):
    """Scenario as it is written; its steps are validated one by one."""

    start: ScenarioStart = ScenarioStart()
    foot: FootSection | None = None
    steps: list[Any] = Field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Scenario:
    """Start of the vehicle, what a foot does on its pedals, and the faults in time."""

    start: ScenarioStart
    steps: tuple[Step, ...]
    foot: Foot | None = None

    def faults(
        self, codec: Codec, start_ns: int, report: Report = lambda _: None
    ) -> list[FaultInterval]:
        """Faults for `Nodes`; `report` is called when each step begins and ends."""
        return [step.interval(codec, start_ns, report) for step in self.steps]

    def check_pedals(self, there_are: bool, where: str) -> None:
        """ConfigError where a foot has no pedals to press; `where` is the scenario's file."""
        if self.foot is not None and not there_are:
            remedy = "take a configuration with them (-c), such as config/examples/pedals.yaml"
            raise ConfigError(Problem("foot needs the pedals of pedals.can", where, remedy))


def load(path: Path, protocol: ProtocolSpec) -> Scenario:
    """Read a scenario; ConfigError names everything that is wrong with it."""
    return parse(file_text.read(path), str(path), protocol)


def parse(contents: str, where: str, protocol: ProtocolSpec) -> Scenario:
    """As `load`, from text; `where` is the file that errors name."""
    read = parser.read(contents)
    if read.is_yaml and not isinstance(read.value, dict):
        remedy = f"write `steps:` and below it lines such as `- {_EXAMPLE}`"
        raise ConfigError(Problem("is no scenario", where, remedy))
    outline, found = validation.validated_document(_File, read)
    known = {finding.path for finding in read.findings}
    steps: list[Step] = []
    written = read.value.get("steps") if read.is_yaml else None
    for index, value in enumerate(written if isinstance(written, list) else ()):
        step, wrong = _step(value, ("steps", index), protocol)
        found += [finding for finding in wrong if finding.path not in known]
        steps += [step] if step else []
    if outline is None or found:
        raise ConfigError(*problems(found, where, read.lines))
    foot = None if outline.foot is None else outline.foot.foot
    return Scenario(outline.start, tuple(steps), foot)


def _step(value: Any, at: KeyPath, protocol: ProtocolSpec) -> tuple[Step | None, list[FileProblem]]:
    names = ", ".join(FAULTS)
    if not isinstance(value, dict):
        return None, [FileProblem(at, f"must be a step such as {_EXAMPLE}, not {shown(value)}")]
    if "fault" not in value:
        return None, [FileProblem(at, "has no fault", f"add `fault:` and one of {names}")]
    fault = value["fault"]
    if not isinstance(fault, str) or fault not in FAULTS:
        what = f"must be one of {names}, not {shown(fault)}"
        return None, [FileProblem((*at, "fault"), what, did_you_mean(str(fault), FAULTS))]
    step, refused = validation.validated(FAULTS[fault], value, {PROTOCOL: protocol})
    return step, [finding._replace(path=(*at, *finding.path)) for finding in refused]
