"""Inputs of the core: every call that may change it, as a value.

The same inputs in the same order give the same results again. A drive is recorded as the inputs
and their results, and replayed by applying them to another gateway:

    for one in inputs:
        answer = one.apply(gateway)
"""

from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.core.demand import Demand, RequestResult
from vcu_gateway.core.frame import Frame
from vcu_gateway.core.gateway import Gateway, TickResult
from vcu_gateway.core.link import Carrier, LinkStatus
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.core.transmit import OutFrame


class FrameInput(NamedTuple):
    """`Gateway.receive`."""

    frame: Frame

    def apply(self, gateway: Gateway) -> None:
        """Make the call."""
        gateway.receive(self.frame)


class LinkLostInput(NamedTuple):
    """`Gateway.link_lost`."""

    at_ns: int

    def apply(self, gateway: Gateway) -> None:
        """Make the call."""
        gateway.link_lost(self.at_ns)


class LinkOpenedInput(NamedTuple):
    """`Gateway.link_opened`."""

    link: LinkStatus
    carrier: Carrier | None
    now_ns: int

    def apply(self, gateway: Gateway) -> None:
        """Make the call."""
        gateway.link_opened(self.link, self.carrier, self.now_ns)


class CarrierInput(NamedTuple):
    """`Gateway.carrier_changed`."""

    carrier: Carrier

    def apply(self, gateway: Gateway) -> None:
        """Make the call."""
        gateway.carrier_changed(self.carrier)


class RestartsInput(NamedTuple):
    """`Gateway.restarted`."""

    unexpectedly: int

    def apply(self, gateway: Gateway) -> None:
        """Make the call."""
        gateway.restarted(self.unexpectedly)


class BeginInput(NamedTuple):
    """`Gateway.begin_from`."""

    cut_reason: str | None
    reverse: Mapping[str, bool]

    def apply(self, gateway: Gateway) -> None:
        """Make the call."""
        gateway.begin_from(self.cut_reason, self.reverse)


class RestartStateInput(NamedTuple):
    """`Gateway.restart_state_tried`."""

    failure: str | None

    def apply(self, gateway: Gateway) -> None:
        """Make the call."""
        gateway.restart_state_tried(self.failure)


class OfferInput(NamedTuple):
    """`OperatorRequests.offer`."""

    demand: Demand
    now_ns: int

    def apply(self, gateway: Gateway) -> RequestResult:
        """Make the call."""
        return gateway.requests.offer(self.demand, self.now_ns)


class EndDemandInput(NamedTuple):
    """`OperatorRequests.end_demand`."""

    source: str
    now_ns: int

    def apply(self, gateway: Gateway) -> RequestResult:
        """Make the call."""
        return gateway.requests.end_demand(self.source, self.now_ns)


class ArmInput(NamedTuple):
    """`OperatorRequests.arm`."""

    now_ns: int

    def apply(self, gateway: Gateway) -> RequestResult:
        """Make the call."""
        return gateway.requests.arm(self.now_ns)


class DisarmInput(NamedTuple):
    """`OperatorRequests.disarm`."""

    now_ns: int

    def apply(self, gateway: Gateway) -> RequestResult:
        """Make the call."""
        return gateway.requests.disarm(self.now_ns)


class ResetInput(NamedTuple):
    """`OperatorRequests.reset`."""

    level: FaultClass
    now_ns: int

    def apply(self, gateway: Gateway) -> RequestResult:
        """Make the call."""
        return gateway.requests.reset(self.level, self.now_ns)


class EmergencyStopInput(NamedTuple):
    """`OperatorRequests.emergency_stop`."""

    def apply(self, gateway: Gateway) -> RequestResult:
        """Make the call."""
        return gateway.requests.emergency_stop()


class TerminateInput(NamedTuple):
    """`OperatorRequests.terminate`."""

    def apply(self, gateway: Gateway) -> None:
        """Make the call."""
        gateway.requests.terminate()


class ReloadInput(NamedTuple):
    """`Gateway.reload`."""

    settings: Settings

    def apply(self, gateway: Gateway) -> RequestResult:
        """Make the call."""
        return gateway.reload(self.settings)


class TickInput(NamedTuple):
    """`Gateway.tick`."""

    now_ns: int

    def apply(self, gateway: Gateway) -> TickResult:
        """Make the call."""
        return gateway.tick(self.now_ns)


class SentInput(NamedTuple):
    """`Gateway.sent`."""

    frame: OutFrame
    ok: bool
    now_ns: int

    def apply(self, gateway: Gateway) -> None:
        """Make the call."""
        gateway.sent(self.frame, self.ok, self.now_ns)


CoreInput = (
    FrameInput
    | LinkLostInput
    | LinkOpenedInput
    | CarrierInput
    | RestartsInput
    | BeginInput
    | RestartStateInput
    | OfferInput
    | EndDemandInput
    | ArmInput
    | DisarmInput
    | ResetInput
    | EmergencyStopInput
    | TerminateInput
    | ReloadInput
    | TickInput
    | SentInput
)
"""One call; the order of the members is that of docs/recordings-format.md."""
