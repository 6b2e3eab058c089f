"""Told commands: what the recorded controllers were told, for the rules that judge their echoes.

A controller's Status1 echoes the recorded command. Held against what another configuration would
have sent, every difference would look like a controller that does not obey, and stop the drive.
"""

from collections.abc import Mapping

from vcu_gateway.core.codec import Codec
from vcu_gateway.core.commands import message_name
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.spec import FRAME_LENGTH_BYTES
from vcu_gateway.core.transmit import SentValues


class ToldCommands:
    """Recorded commands put into a core's history of what it sent."""

    def __init__(self, codec: Codec) -> None:
        self._codecs = {name: codec.by_name[message_name(name)] for name in CONTROLLERS}
        self._places: Mapping[str, tuple[int, int]] = {
            name: (
                one.spec.signal_names.index("Throttle"),
                one.spec.signal_names.index("MotorReverse"),
            )
            for name, one in self._codecs.items()
        }

    def of(self, controller: str, data: bytes | bytearray, at_ns: int) -> SentValues:
        """Throttle and direction of a command that left then."""
        values = self._codecs[controller].decode(data).values
        throttle, reverse = self._places[controller]
        return SentValues(at_ns, values[throttle], bool(values[reverse]))

    def add(self, gateway: Gateway, controller: str, data: bytes | bytearray, at_ns: int) -> None:
        """Beside what the core sent itself."""
        if len(data) == FRAME_LENGTH_BYTES:
            told = self.of(controller, data, at_ns)
            gateway.transmitter.history.frames[controller].append(told)

    def put(self, gateway: Gateway, controller: str, data: bytes, at_ns: int) -> None:
        """Instead of what the core sent last."""
        frames = gateway.transmitter.history.frames[controller]
        if frames and len(data) == FRAME_LENGTH_BYTES:
            frames[-1] = self.of(controller, data, at_ns)
