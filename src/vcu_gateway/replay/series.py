"""Series of both sides' commands, for plots: one point a tick, four bytes a value."""

import math
from array import array
from collections.abc import Mapping

from vcu_gateway.core.codec import Codec
from vcu_gateway.core.commands import message_name
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.transmit import OutFrame

_SIGNALS = ("Throttle", "Brake", "PowerMode", "MotorReverse", "SpeedLimit", "PowerLimit")
_NAN = math.nan


class CommandSeries:
    """Commands of the replayed side.

    Attributes:
        times_ns: of the ticks, on the gateway's clock.
        values: by message and signal, such as "VCU_PCU1_Command.Throttle"; NaN without a frame.
    """

    def __init__(self, codec: Codec) -> None:
        self.times_ns = array("q")
        self.values: Mapping[str, array[float]] = {
            f"{message_name(name)}.{signal}": array("f")
            for name in CONTROLLERS
            for signal in _SIGNALS
        }
        self._decoders = {name: codec.by_name[message_name(name)] for name in CONTROLLERS}
        self._places = {
            name: [one.spec.signal_names.index(signal) for signal in _SIGNALS]
            for name, one in self._decoders.items()
        }

    def add(self, now_ns: int, sent: tuple[OutFrame, ...]) -> None:
        """One tick's commands."""
        self.times_ns.append(now_ns)
        frames = {frame.controller: frame for frame in sent}
        for name in CONTROLLERS:
            values = self._values(name, frames.get(name))
            for signal, value in zip(_SIGNALS, values, strict=True):
                self.values[f"{message_name(name)}.{signal}"].append(value)

    def _values(self, name: str, frame: OutFrame | None) -> list[float]:
        if frame is None:
            return [_NAN] * len(_SIGNALS)
        values = self._decoders[name].decode(frame.data).values
        return [values[place] for place in self._places[name]]
