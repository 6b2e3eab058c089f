"""From decided commands to frames on the bus: encoded, checked by the gate, booked."""

from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.core import commands, j1939
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.commands import Command
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.gate import Gate, GateLimits
from vcu_gateway.core.sending import SentHistory, SentValues
from vcu_gateway.core.settings import Settings


class OutFrame(NamedTuple):
    """A command frame to send at once: 29-bit identifier and eight bytes."""

    controller: str
    can_id: int
    data: bytes


class Transmitter:
    """Both controllers' frames.

    Attributes:
        gate: the last check; sending: what became of the frames.
    """

    def __init__(self, codec: Codec, settings: Settings) -> None:
        self._codecs = {name: codec.by_name[commands.message_name(name)] for name in CONTROLLERS}
        self._can_ids = {
            name: j1939.with_priority(one.spec.can_id, settings.transmit_priority)
            for name, one in self._codecs.items()
        }
        # One whole byte and one bit, the same in both: what they say needs no decoding.
        self._throttle = self._codecs[CONTROLLERS[0]].spec.signal("Throttle")
        self._throttle_byte = self._throttle.start_bit // 8
        direction = self._codecs[CONTROLLERS[0]].spec.signal("MotorReverse").start_bit
        self._direction_byte, self._reverse = direction // 8, 1 << direction % 8
        self.gate = Gate(self._limits(settings))
        self.sending = SentHistory(CONTROLLERS)

    def _limits(self, settings: Settings) -> GateLimits:
        return GateLimits(
            allowed=tuple(self._can_ids.values()),
            speed_limit_max_rpm=settings.speed_limit_max_rpm,
            power_limit_max_w=settings.power_limit_max_w,
            throttle_slew_pct_per_s=settings.throttle_slew_pct_per_s,
            direction_change_rpm=settings.direction_change_rpm,
            period_ns=settings.period_ns,
            power_slew_w_per_s=settings.power_slew_w_per_s,
            speed_slew_rpm_per_s=settings.speed_slew_rpm_per_s,
            regen_min_rpm=settings.regen_min_rpm,
            independent_directions=settings.independent_directions,
        )

    def reload(self, settings: Settings) -> None:
        """Hold frames against new limits from now on."""
        self.gate.limits = self._limits(settings)

    def encoded(self, decided: Mapping[str, Command]) -> tuple[OutFrame, ...]:
        """The frames of these commands, one for each controller."""
        return tuple(
            OutFrame(name, self._can_ids[name], codec.encode(decided[name].signals()))
            for name, codec in self._codecs.items()
        )

    def fault_of(
        self,
        frames: tuple[OutFrame, ...],
        armed: bool,
        speeds_rpm: tuple[float | None, ...],
        now_ns: int,
    ) -> str | None:
        """Show every frame to the gate; the rule that one of them breaks, or None."""
        passed = [
            self.gate.check(
                slot,
                frame.can_id,
                frame.data,
                armed=armed,
                speeds_rpm=speeds_rpm,
                now_ns=now_ns,
            )
            for slot, frame in enumerate(frames)
        ]
        return next((one.blocked for one in passed if one.blocked), None)

    def note_sent(self, frame: OutFrame, now_ns: int) -> None:
        """Book a frame that the bus took."""
        throttle_pct = frame.data[self._throttle_byte] * self._throttle.factor
        reverse = frame.data[self._direction_byte] & self._reverse != 0
        self.gate.sent(CONTROLLERS.index(frame.controller), frame.data, now_ns)
        self.sending.note_sent(frame.controller, SentValues(now_ns, throttle_pct, reverse))
