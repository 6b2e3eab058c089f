"""Calls of the core as values: every one that may change it, one class each.

The same calls in the same order give the same results again. The shell makes them with
`Gateway.apply`, where a tap notes them; a drive is recorded as the calls and their answers, and
replayed by applying them to another gateway:

    gateway.apply(Arm(now_ns)).granted

`Gateway.receive` and `Gateway.tick` are called themselves: there are many of them. A new call is a
class here and its word in `WORDS`; a recording has its fields as `recording/call_text.py` writes
their types.
"""

from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.core.demand import Demand, RequestResult
from vcu_gateway.core.gateway import CoreCall, Gateway, TickResult
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import Carrier, LinkStatus
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.core.transmit import OutFrame


class Receive(NamedTuple):
    """`Gateway.receive`."""

    frame: Frame

    def apply(self, gateway: Gateway) -> None:
        gateway.receive(self.frame)


class LoseLink(NamedTuple):
    """The interface is down or gone."""

    at_ns: int

    def apply(self, gateway: Gateway) -> None:
        gateway.receiver.monitor.lose(self.at_ns)


class OpenLink(NamedTuple):
    """`Gateway.link_opened`."""

    link: LinkStatus
    carrier: Carrier | None
    now_ns: int

    def apply(self, gateway: Gateway) -> None:
        gateway.link_opened(*self)


class ChangeCarrier(NamedTuple):
    """The carrier of the open interface came or went."""

    carrier: Carrier

    def apply(self, gateway: Gateway) -> None:
        gateway.receiver.monitor.change_carrier(self.carrier)


class CountRestarts(NamedTuple):
    """How often the gateway was started in this drive without having ended in order."""

    unexpectedly: int

    def apply(self, gateway: Gateway) -> None:
        gateway.requests.restarts = self.unexpectedly


class BeginFrom(NamedTuple):
    """`Gateway.begin_from`."""

    cut_reason: str | None
    reverse: Mapping[str, bool]

    def apply(self, gateway: Gateway) -> None:
        gateway.begin_from(*self)


class NoteRestartState(NamedTuple):
    """Whether the restart state was kept when that was last tried: why not, or None."""

    failure: str | None

    def apply(self, gateway: Gateway) -> None:
        gateway.requests.restart_state_failure = self.failure


class Offer(NamedTuple):
    """`OperatorRequests.offer`."""

    demand: Demand
    now_ns: int

    def apply(self, gateway: Gateway) -> RequestResult:
        return gateway.requests.offer(*self)


class EndDemand(NamedTuple):
    """`OperatorRequests.end_demand`."""

    source: str
    now_ns: int

    def apply(self, gateway: Gateway) -> RequestResult:
        return gateway.requests.end_demand(*self)


class Arm(NamedTuple):
    """`OperatorRequests.arm`."""

    now_ns: int

    def apply(self, gateway: Gateway) -> RequestResult:
        return gateway.requests.arm(self.now_ns)


class Disarm(NamedTuple):
    """`OperatorRequests.disarm`."""

    now_ns: int

    def apply(self, gateway: Gateway) -> RequestResult:
        return gateway.requests.disarm(self.now_ns)


class Reset(NamedTuple):
    """`OperatorRequests.reset`."""

    level: FaultClass
    now_ns: int

    def apply(self, gateway: Gateway) -> RequestResult:
        return gateway.requests.reset(*self)


class EmergencyStop(NamedTuple):
    """`OperatorRequests.emergency_stop`."""

    def apply(self, gateway: Gateway) -> RequestResult:
        return gateway.requests.emergency_stop()


class Terminate(NamedTuple):
    """`OperatorRequests.terminate`."""

    def apply(self, gateway: Gateway) -> None:
        gateway.requests.terminate()


class SetDriveMode(NamedTuple):
    """`Gateway.set_drive_mode`."""

    mode: str
    level: FaultClass
    now_ns: int

    def apply(self, gateway: Gateway) -> RequestResult:
        return gateway.set_drive_mode(*self)


class BeginInMode(NamedTuple):
    """`Gateway.begin_in_mode`."""

    mode: str

    def apply(self, gateway: Gateway) -> None:
        gateway.begin_in_mode(self.mode)


class ReloadSettings(NamedTuple):
    """`Gateway.reload`."""

    settings: Settings

    def apply(self, gateway: Gateway) -> RequestResult:
        return gateway.reload(self.settings)


class RunTick(NamedTuple):
    """`Gateway.tick`."""

    now_ns: int

    def apply(self, gateway: Gateway) -> TickResult:
        return gateway.tick(self.now_ns)


class NoteSent(NamedTuple):
    """`Gateway.sent`."""

    frame: OutFrame
    ok: bool
    now_ns: int

    def apply(self, gateway: Gateway) -> None:
        gateway.sent(*self)


WORDS: Mapping[type[CoreCall[object]], str] = {
    Offer: "offer",
    NoteSent: "sent",
    RunTick: "tick",
    LoseLink: "link_lost",
    OpenLink: "link_opened",
    ChangeCarrier: "carrier_changed",
    CountRestarts: "restarted",
    BeginFrom: "begin_from",
    NoteRestartState: "restart_state",
    EndDemand: "end_demand",
    Arm: "arm",
    Disarm: "disarm",
    Reset: "reset",
    EmergencyStop: "estop",
    Terminate: "terminate",
    ReloadSettings: "reload",
    SetDriveMode: "drive_mode",
    BeginInMode: "begin_in_mode",
}
"""Word of each call in a recording (docs/recordings-format.md); frames have files of their own."""
