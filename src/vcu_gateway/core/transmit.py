"""Transmitter: commands encoded, checked by the gate, and recorded once they are sent."""

from collections import deque
from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.core import commands, j1939
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.commands import Command
from vcu_gateway.core.demand import CONTROLLERS, RELEASED_PCT, ControllerDemands
from vcu_gateway.core.gate import Gate
from vcu_gateway.core.settings import Settings


class OutFrame(NamedTuple):
    """A command frame to send at once: 29-bit identifier and eight bytes."""

    controller: str
    can_id: int
    data: bytes


class TakenFrame(NamedTuple):
    """A command frame that the kernel took."""

    frame: OutFrame
    at_ns: int


class Transmitter:
    """Encoder and gate of both controllers' frames.

    Attributes:
        gate: the last check of every frame.
        history: values of the frames that the bus took.
        taken: the last of these frames, by controller.
    """

    def __init__(self, codec: Codec, settings: Settings) -> None:
        self._codecs = {name: codec.by_name[commands.message_name(name)] for name in CONTROLLERS}
        self._can_ids = {
            name: j1939.with_priority(one.spec.can_id, settings.transmit_priority)
            for name, one in self._codecs.items()
        }
        first, *others = (one.spec.signals for one in self._codecs.values())
        self._same_layout = all(first == other for other in others)
        # One whole byte and one bit, the same in both: they need no decoding.
        self._throttle = self._codecs[CONTROLLERS[0]].spec.signal("Throttle")
        self._throttle_byte = self._throttle.start_bit // 8
        direction = self._codecs[CONTROLLERS[0]].spec.signal("MotorReverse").start_bit
        self._direction_byte, self._reverse = direction // 8, 1 << direction % 8
        self.gate = Gate(tuple(self._can_ids.values()), settings)
        self.history = SentHistory(CONTROLLERS)
        self.taken: dict[str, TakenFrame] = {}

    def power_cut_bits(self) -> Mapping[str, tuple[int, int]]:
        """Byte and mask of POWER_CUT in each controller's command."""
        starts = {name: one.spec.signal("PowerCut").start_bit for name, one in self._codecs.items()}
        return {name: (start // 8, 1 << start % 8) for name, start in starts.items()}

    def encoded(self, decided: Mapping[str, Command]) -> tuple[OutFrame, ...]:
        """The frames of these commands, one for each controller; mostly both have the same data."""
        frames: list[OutFrame] = []
        before: Command | None = None
        for name, codec in self._codecs.items():
            command = decided[name]
            if command != before or not self._same_layout:
                data = codec.encode(command.signals())
            frames.append(OutFrame(name, self._can_ids[name], data))
            before = command
        return tuple(frames)

    def fault_of(
        self,
        frames: tuple[OutFrame, ...],
        armed: bool,
        demanded: ControllerDemands | None,
        speeds_rpm: tuple[float | None, ...],
        now_ns: int,
    ) -> str | None:
        """Show every frame to the gate; the rule that one of them breaks, or None."""
        fault: str | None = None
        for slot, frame in enumerate(frames):
            broken = self.gate.check(
                slot,
                frame.can_id,
                frame.data,
                armed=armed,
                demanded=None if demanded is None else demanded[frame.controller],
                speeds_rpm=speeds_rpm,
                now_ns=now_ns,
            )
            fault = fault or broken
        if fault or demanded is None or frames[0].data == frames[-1].data:
            return fault
        alike = demanded[CONTROLLERS[0]] == demanded[CONTROLLERS[1]]
        return self.gate.check_both(frames[0].data, frames[-1].data, alike)

    def note_sent(self, frame: OutFrame, now_ns: int) -> None:
        throttle_pct = frame.data[self._throttle_byte] * self._throttle.factor
        reverse = frame.data[self._direction_byte] & self._reverse != 0
        self.taken[frame.controller] = TakenFrame(frame, now_ns)
        self.gate.sent(CONTROLLERS.index(frame.controller), frame.data, now_ns)
        self.history.note_sent(frame.controller, SentValues(now_ns, throttle_pct, reverse))


# The echo is held against a second or so before a Status1 that may be 1.6 s old.
_HISTORY_FRAMES = 80


class SentValues(NamedTuple):
    """Throttle and direction of one command frame that was sent."""

    at_ns: int
    throttle_pct: float
    reverse: bool = False


class SentHistory:
    """Last frames that left for each controller, and whether they came back as echoes.

    Attributes:
        frames: values of the last 80 frames of each controller, oldest first.
        begun: a frame has left for every controller.
        emitted: the last tick gave frames to send at all.
    """

    def __init__(self, controllers: tuple[str, ...]) -> None:
        self.frames: Mapping[str, deque[SentValues]] = {
            name: deque(maxlen=_HISTORY_FRAMES) for name in controllers
        }
        self._confirmed_before = dict.fromkeys(controllers, 0)
        self._missed = dict.fromkeys(controllers, 0)
        self.begun = self.emitted = False

    def note_sent(self, controller: str, sent: SentValues) -> None:
        self.frames[controller].append(sent)
        self.begun = self.begun or all(self.frames.values())

    @property
    def released(self) -> bool:
        """The throttle last sent to each controller was below 5 %."""
        for sent in self.frames.values():
            if not sent or sent[-1].throttle_pct >= RELEASED_PCT:
                return False
        return True

    @property
    def unsent(self) -> list[str]:
        return [name for name, sent in self.frames.items() if not sent]

    def note_confirmed(self, confirmed: Mapping[str, int]) -> int:
        """Take the echo counts at the start of a tick; ticks in a row without an echo."""
        for name, count in confirmed.items():
            if count != self._confirmed_before[name]:
                self._missed[name] = 0
            elif self.emitted:
                self._missed[name] += 1
            self._confirmed_before[name] = count
        return max(self._missed.values())
