"""Receiver: frames from the bus, sorted into messages, echoes, foreign commands and rejects.

What is known of the link is in `LinkMonitor`. Any thread may read.
"""

from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.core import commands, j1939
from vcu_gateway.core.can_pedals import CanPedals
from vcu_gateway.core.codec import Codec, Reason
from vcu_gateway.core.demand import CONTROLLERS
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import LinkMonitor
from vcu_gateway.core.pedal_frames import PedalFault, PedalFrames
from vcu_gateway.core.state import MOST_ARRIVALS, Store

OWN_NODE = "VCU"


class FrameCounters(NamedTuple):
    """Frames since the start that are no messages, or of which not all counts.

    Attributes:
        rejected: not decoded, or no demand of the pedals, by reason.
        out_of_order: older than the frame of their message before them.
        unjudged: too many of one message for a tick to judge.
        confirmed: own commands that came back because they had left, by controller.
        foreign_commands: commands of another sender, by controller.
        blocked_by_gate: own commands that never left, by the rule that they broke.
    """

    rejected: Mapping[Reason | PedalFault, int]
    out_of_order: int
    unjudged: int
    confirmed: Mapping[str, int]
    foreign_commands: Mapping[str, int]
    blocked_by_gate: Mapping[str, int]


class Receiver:
    """Frames in; messages, echoes, foreign commands, errors and rejects apart.

    Attributes:
        store: the latest message of each kind.
        rejected, confirmed, foreign_commands: as `FrameCounters`; a command to all counts for each.
        echoes: the last of the confirmed, by controller.
        command_groups: controllers by the `j1939.group_key` of what commands them.
        foreign_id: identifier of the last foreign command.
        pedal_frames: those of the pedals since they were last taken.
        monitor: state of the link, from error frames and from what the shell knows.
    """

    def __init__(
        self,
        codec: Codec,
        stale_after_ns: Mapping[str, int],
        now_ns: int,
        pedals: CanPedals | None = None,
    ) -> None:
        self._codec = codec
        self.store = Store(codec.protocol.received_by(OWN_NODE), stale_after_ns)
        self._controller_of = {commands.message_name(name): name for name in CONTROLLERS}
        own_ids = {
            name: codec.by_name[message].spec.can_id
            for message, name in self._controller_of.items()
        }
        self.command_groups = _command_groups(own_ids)
        self.rejected = dict.fromkeys(Reason, 0)
        self.confirmed = dict.fromkeys(CONTROLLERS, 0)
        self.echoes: dict[str, Frame] = {}
        self.foreign_commands = dict.fromkeys(CONTROLLERS, 0)
        self.foreign_count = 0
        self.foreign_id: int | None = None
        self.monitor = LinkMonitor(now_ns)
        self._pedals_message = None if pedals is None else pedals.message
        self.pedal_frames: list[Frame] = []

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
        if name == self._pedals_message and len(self.pedal_frames) < MOST_ARRIVALS:
            self.pedal_frames.append(frame)
        self.store.put(name, found.decode(frame.data), frame.arrival_ns)

    def take_pedal_frames(self) -> list[Frame]:
        """Frames of the pedals since the last call, as they came."""
        taken, self.pedal_frames = self.pedal_frames, []
        return taken

    def _reject(self, reason: Reason, frame: Frame) -> None:
        self.rejected[reason] += 1
        if reason is Reason.ERROR:
            self.monitor.take_error_frame(frame.can_id, frame.data, frame.arrival_ns)
        elif frame.extended and not frame.own_echo:
            # Whoever commands a controller is another sender, whatever address it gives and
            # whatever it sends.
            for controller in self.command_groups.get(j1939.group_key(frame.can_id), ()):
                self._receive_command(controller, frame)

    def _receive_command(self, controller: str, frame: Frame) -> None:
        if frame.own_echo:
            self.confirmed[controller] += 1
            self.echoes[controller] = frame
        else:
            self.foreign_id = frame.can_id
            self.foreign_commands[controller] += 1
            self.foreign_count += 1

    def counters(
        self, blocked_by_gate: Mapping[str, int], pedal_frames: PedalFrames
    ) -> FrameCounters:
        rejected: dict[Reason | PedalFault, int] = dict(self.rejected.items())
        rejected.update(pedal_frames.rejected.items())
        return FrameCounters(
            rejected=rejected,
            out_of_order=self.store.out_of_order,
            unjudged=self.store.unjudged,
            confirmed=dict(self.confirmed),
            foreign_commands=dict(self.foreign_commands),
            blocked_by_gate=dict(blocked_by_gate),
        )


def _command_groups(own_ids: Mapping[str, int]) -> Mapping[int, tuple[str, ...]]:
    """The commands' groups to each controller and to all, whichever of the commands it is."""
    groups: dict[int, tuple[str, ...]] = {}
    for can_id in own_ids.values():
        for name, own_id in own_ids.items():
            destination = j1939.parse(own_id).pdu_specific
            groups[j1939.group_key_to(can_id, destination)] = (name,)
        groups[j1939.group_key_to(can_id, j1939.GLOBAL_ADDRESS)] = tuple(own_ids)
    return groups
