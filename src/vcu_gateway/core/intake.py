"""What comes from the bus, sorted on the receiving thread.

Everything here is written by the receiving thread alone and read by any; what the ticking
thread knows of the link stands apart (`LinkBook`).
"""

from collections.abc import Mapping

from vcu_gateway.core import commands, j1939
from vcu_gateway.core.codec import Codec, Reason
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.frame import Frame
from vcu_gateway.core.link import Link, LinkBook
from vcu_gateway.core.state import Store

OWN_NODE = "VCU"


class Intake:
    """Frames in; messages, echoes, foreign commands, errors and rejects apart.

    Attributes:
        store: the latest message of each kind.
        rejected: frames not decoded, by reason.
        confirmed: own command frames that came back because they had left, by controller.
        foreign_commands: command frames from another sender, by controller.
        foreign_id: identifier of the last one of them.
        book: what error frames and carrier say of the bus; `link` is the result.
    """

    def __init__(self, codec: Codec, stale_after_ns: Mapping[str, int], now_ns: int) -> None:
        self._codec = codec
        self.store = Store(codec.protocol.received_by(OWN_NODE), stale_after_ns)
        self._controller_of = {commands.message_name(name): name for name in CONTROLLERS}
        self._controller_by_key = {
            j1939.match_key(codec.by_name[message].spec.can_id): name
            for message, name in self._controller_of.items()
        }
        self.rejected = dict.fromkeys(Reason, 0)
        self.confirmed = dict.fromkeys(CONTROLLERS, 0)
        self.foreign_commands = dict.fromkeys(CONTROLLERS, 0)
        self.foreign_id: int | None = None
        self.book = LinkBook(now_ns)

    @property
    def link(self) -> Link:
        """What error frames and carrier say of the bus."""
        return self.book.link

    @link.setter
    def link(self, opened: Link) -> None:
        """The interface was opened: what was said before no longer counts."""
        self.book.begin(opened)

    def receive(self, frame: Frame) -> None:
        """Take in one frame; one that is not decoded is counted and changes no message."""
        found = self._codec.find(frame)
        if isinstance(found, Reason):
            self._reject(found, frame)
            return
        name = found.spec.name
        if name in self._controller_of:
            self._receive_command(self._controller_of[name], frame)
            return
        self.store.put(name, found.decode(frame.data), frame.arrival_ns)

    def _reject(self, reason: Reason, frame: Frame) -> None:
        self.rejected[reason] += 1
        if reason is Reason.ERROR:
            self.book.take_error_frame(frame.can_id, frame.data, frame.arrival_ns)
        elif frame.extended and not frame.own_echo:
            # Another sender of our identifiers is one whatever it sends in them.
            controller = self._controller_by_key.get(j1939.match_key(frame.can_id))
            if controller is not None:
                self._receive_command(controller, frame)

    def _receive_command(self, controller: str, frame: Frame) -> None:
        if frame.own_echo:
            self.confirmed[controller] += 1
        else:
            self.foreign_id = frame.can_id
            self.foreign_commands[controller] += 1

    @property
    def foreign_count(self) -> int:
        """Command frames from another sender so far."""
        return sum(self.foreign_commands.values())
