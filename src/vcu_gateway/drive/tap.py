"""Tap: a gateway core that notes every call and its result, for the recorder.

It behaves as the core does, and costs an append a frame. Belongs to the ticking thread.
"""

from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.core import inputs
from vcu_gateway.core.codec import Codec
from vcu_gateway.core.demand import Demand, RequestResult
from vcu_gateway.core.events import Event
from vcu_gateway.core.frame import Frame
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.link import Carrier, LinkStatus
from vcu_gateway.core.operator_requests import OperatorRequests
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.core.transmit import OutFrame
from vcu_gateway.drive.core_lines import CoreCall
from vcu_gateway.drive.records import ShellEvent, WhyRecord
from vcu_gateway.drive_format import datagram


class Noted(NamedTuple):
    """Frames and calls since the last take, each in its order."""

    frames: list[Frame]
    calls: list[CoreCall]


class Tap:
    """Gathers frames and calls in the order in which the core was given them.

    Attributes:
        frames, calls: since the last take.
        ticks: so far.
        events: of the last tick's result.
    """

    def __init__(self) -> None:
        self.frames: list[Frame] = []
        self.calls: list[CoreCall] = []
        self.ticks = 0
        self.events: tuple[Event, ...] = ()

    def note(
        self,
        what: inputs.CoreInput | WhyRecord | ShellEvent,
        answer: RequestResult | TickResult | None = None,
    ) -> None:
        """A call that was made, or what is to stand at this place beside the calls."""
        self.calls.append(CoreCall(len(self.frames), what, answer))

    def take(self) -> Noted:
        """Everything since the last time."""
        noted = Noted(self.frames[:], self.calls[:])
        self.frames.clear()
        self.calls.clear()
        return noted


class TappedGateway(Gateway):
    """Gateway core whose calls are noted."""

    # Not among the attributes of the core: a checkpoint keeps those.
    __slots__ = ("_note_frame", "tap")

    def __init__(self, codec: Codec, settings: Settings, now_ns: int, tap: Tap) -> None:
        super().__init__(codec, settings, now_ns)
        self.tap = tap
        self._note_frame = tap.frames.append
        self.requests = TappedRequests(self.requests, tap)

    def receive(self, frame: Frame) -> None:
        """Note and take in one frame."""
        self._note_frame(frame)
        self.receiver.receive(frame)

    def link_lost(self, now_ns: int) -> None:
        """Note and hand on."""
        self.tap.note(inputs.LinkLostInput(now_ns))
        super().link_lost(now_ns)

    def link_opened(self, link: LinkStatus, carrier: Carrier | None, now_ns: int) -> None:
        """Note and hand on."""
        self.tap.note(inputs.LinkOpenedInput(link, carrier, now_ns))
        super().link_opened(link, carrier, now_ns)

    def carrier_changed(self, carrier: Carrier) -> None:
        """Note and hand on."""
        self.tap.note(inputs.CarrierInput(carrier))
        super().carrier_changed(carrier)

    def restarted(self, unexpectedly: int) -> None:
        """Note and hand on."""
        self.tap.note(inputs.RestartsInput(unexpectedly))
        super().restarted(unexpectedly)

    def begin_from(self, cut_reason: str | None, reverse: Mapping[str, bool]) -> None:
        """Note and hand on."""
        self.tap.note(inputs.BeginInput(cut_reason, dict(reverse)))
        super().begin_from(cut_reason, reverse)

    def restart_state_tried(self, failure: str | None) -> None:
        """Note and hand on."""
        self.tap.note(inputs.RestartStateInput(failure))
        super().restart_state_tried(failure)

    def sent(self, frame: OutFrame, ok: bool, now_ns: int) -> None:
        """Note and hand on."""
        self.tap.note(inputs.SentInput(frame, ok, now_ns))
        super().sent(frame, ok, now_ns)

    def reload(self, settings: Settings) -> RequestResult:
        """Hand on, and note with the answer."""
        answer = super().reload(settings)
        self.tap.note(inputs.ReloadInput(settings), answer)
        return answer

    def tick(self, now_ns: int) -> TickResult:
        """Hand on, and note with the result; a tick that fails is noted without one."""
        try:
            result = super().tick(now_ns)
        except Exception:
            self.tap.note(inputs.TickInput(now_ns))
            raise
        tap = self.tap
        tap.note(inputs.TickInput(now_ns), result)
        tap.ticks += 1
        tap.events = result.events
        return result


class TappedRequests(OperatorRequests):
    """Requests of operators, which are noted with their answers."""

    __slots__ = ("_note",)

    def __init__(self, requests: OperatorRequests, tap: Tap) -> None:
        vars(self).update(vars(requests))
        self._note = tap.note

    def offer(self, demand: Demand, now_ns: int) -> RequestResult:
        """Hand on, and note with the answer."""
        answer = super().offer(demand, now_ns)
        self._note(inputs.OfferInput(demand, now_ns), answer)
        return answer

    def end_demand(self, source: str, now_ns: int) -> RequestResult:
        """Hand on, and note with the answer."""
        answer = super().end_demand(source, now_ns)
        self._note(inputs.EndDemandInput(source, now_ns), answer)
        return answer

    def arm(self, now_ns: int) -> RequestResult:
        """Hand on, and note with the answer."""
        answer = super().arm(now_ns)
        self._note(inputs.ArmInput(now_ns), answer)
        return answer

    def disarm(self, now_ns: int) -> RequestResult:
        """Hand on, and note with the answer."""
        answer = super().disarm(now_ns)
        self._note(inputs.DisarmInput(now_ns), answer)
        return answer

    def reset(self, level: FaultClass, now_ns: int) -> RequestResult:
        """Hand on, and note with the answer."""
        answer = super().reset(level, now_ns)
        self._note(inputs.ResetInput(level, now_ns), answer)
        return answer

    def emergency_stop(self) -> RequestResult:
        """Hand on, and note with the answer."""
        answer = super().emergency_stop()
        self._note(inputs.EmergencyStopInput(), answer)
        return answer

    def terminate(self) -> None:
        """Note and hand on."""
        self._note(inputs.TerminateInput())
        super().terminate()


def packed_frames(frames: list[Frame]) -> list[bytes]:
    """The frames as a datagram has them."""
    pack, extended = datagram.CLASSIC.pack, datagram.EXTENDED
    return [
        pack(frame.arrival_ns, frame.can_id | extended, frame.own_echo, 8, frame.data)
        if frame.extended and len(frame.data) == 8 and not frame.error and not frame.remote
        else _packed_frame(frame)
        for frame in frames
    ]


def _packed_frame(frame: Frame) -> bytes:
    return datagram.packed_frame(*recorded_frame(frame))


def recorded_frame(frame: Frame) -> datagram.FrameRecord:
    """The frame with Linux's flags in its identifier."""
    can_id = frame.can_id & datagram.ID_MASK
    if frame.extended:
        can_id |= datagram.EXTENDED
    if frame.remote:
        can_id |= datagram.REMOTE
    if frame.error:
        can_id |= datagram.ERROR
    return datagram.FrameRecord(frame.arrival_ns, can_id, frame.own_echo, bytes(frame.data))


def frame_of(record: datagram.FrameRecord) -> Frame:
    """Frame of the core from one of a datagram."""
    can_id = record.can_id
    return Frame(
        can_id & datagram.ID_MASK,
        record.data,
        record.arrival_ns,
        extended=can_id & datagram.EXTENDED != 0,
        remote=can_id & datagram.REMOTE != 0,
        error=can_id & datagram.ERROR != 0,
        own_echo=record.own_echo,
    )
