"""The machine without a bus: frames and time in, command frames and events out."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from vcu_gateway.core import commands, freshness, j1939
from vcu_gateway.core.codec import Codec, MessageCodec, Reason
from vcu_gateway.core.commands import CONTROLLERS, Command
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.frame import Frame
from vcu_gateway.core.state import Snapshot, Store

_OWN_NODE = "VCU"
_DEFAULT_PERIOD_MS = 50
_NS_PER_MS = 1_000_000


@dataclass(frozen=True, slots=True)
class Settings:
    """What the configuration tells the core.

    Attributes:
        late_after_ms, stale_after_ms: overrides by message name.
        transmit_priority: J1939 priority of the command frames, 0..7.
        bench_demand: static demand for both controllers on a test bench; None on a vehicle.
    """

    late_after_ms: Mapping[str, int] = field(default_factory=dict)
    stale_after_ms: Mapping[str, int] = field(default_factory=dict)
    transmit_priority: int = 0
    speed_limit_max_rpm: float = 12000.0
    power_limit_max_w: float = 60000.0
    bench_demand: ControllerDemand | None = None


class OutFrame(NamedTuple):
    """A command frame to send at once: 29-bit identifier and eight bytes."""

    message: str
    can_id: int
    data: bytes


class TickResult(NamedTuple):
    """What one tick decided, all of it from one snapshot."""

    snapshot: Snapshot
    commands: Mapping[str, Command]
    frames: tuple[OutFrame, ...]


class Gateway:
    """Receives frames on one thread, ticks on another; no lock between them.

    Counters are written by the receiving thread alone and read by any.

    Attributes:
        rejected: frames not decoded, by reason.
        confirmed: own command frames that came back because they had left, by message.
        foreign_commands: command identifiers seen from another sender, by message.
    """

    def __init__(self, codec: Codec, settings: Settings) -> None:
        self.codec = codec
        self._settings = settings
        received = codec.protocol.received_by(_OWN_NODE)
        stale_after_ns = {
            message.name: freshness.deadlines(
                message, settings.late_after_ms, settings.stale_after_ms
            ).stale_after_ns
            for message in received
        }
        self.store = Store(received, stale_after_ns)
        self._outgoing = {
            controller: self._outgoing_codec(controller) for controller in CONTROLLERS
        }
        self._own_names = {message.spec.name for message, _ in self._outgoing.values()}
        self.rejected = dict.fromkeys(Reason, 0)
        self.confirmed = dict.fromkeys(self._own_names, 0)
        self.foreign_commands = dict.fromkeys(self._own_names, 0)

    def _outgoing_codec(self, controller: str) -> tuple[MessageCodec, int]:
        codec = self.codec.by_name[commands.message_name(controller)]
        can_id = j1939.with_priority(codec.spec.can_id, self._settings.transmit_priority)
        return codec, can_id

    @property
    def period_ns(self) -> int:
        """The commands' period, from the protocol."""
        codec, _ = self._outgoing[CONTROLLERS[0]]
        return (codec.spec.period_ms or _DEFAULT_PERIOD_MS) * _NS_PER_MS

    def receive(self, frame: Frame) -> None:
        """Take in one frame; a frame that is not decoded is counted and changes nothing."""
        found = self.codec.find(frame)
        if isinstance(found, Reason):
            self.rejected[found] += 1
            return
        name = found.spec.name
        if name in self._own_names:
            (self.confirmed if frame.own_echo else self.foreign_commands)[name] += 1
            return
        self.store.put(name, found.decode(frame.data), frame.arrival_ns)

    def tick(self, now_ns: int) -> TickResult:
        """Decide what each controller is told now; both frames come from one snapshot."""
        snapshot = self.store.snapshot(now_ns)
        command = self._command()
        decided = dict.fromkeys(CONTROLLERS, command)
        frames = tuple(self._encode(name, decided[name]) for name in CONTROLLERS)
        return TickResult(snapshot, decided, frames)

    def _command(self) -> Command:
        settings = self._settings
        if settings.bench_demand is None:
            return Command(speed_limit_rpm=settings.speed_limit_max_rpm)
        return commands.from_demand(
            settings.bench_demand, settings.speed_limit_max_rpm, settings.power_limit_max_w
        )

    def _encode(self, controller: str, command: Command) -> OutFrame:
        codec, can_id = self._outgoing[controller]
        return OutFrame(codec.spec.name, can_id, codec.encode(command.signals()))
