"""Whether a request may be granted: the first reason against it, as a sentence."""

from collections.abc import Mapping
from typing import NamedTuple

from vcu_gateway.core.causes import BLOCKING, Causes
from vcu_gateway.core.demand import ControllerDemand, directions_differ
from vcu_gateway.core.supervisor import FaultClass, Mode, Supervisor

_NS_PER_MS = 1_000_000

RELEASED_MS = 200
"""How long the demanded throttle has to be 0 before arming."""

Asked = Mapping[str, ControllerDemand] | None


class Pedal(NamedTuple):
    """The demand as far as arming is concerned.

    Attributes:
        asked: of each controller; None without a fresh demand.
        zero_for_ns: how long no demand asked for throttle; None where it is asked for.
        reverse_pending: another direction than the applied one is asked for.
        independent_directions: the controllers may have two directions.
    """

    asked: Asked
    zero_for_ns: int | None
    reverse_pending: bool = False
    independent_directions: bool = False


def against_arming(supervisor: Supervisor, causes: Causes, pedal: Pedal) -> str:
    """Why ACTIVE cannot be entered now; empty where nothing speaks against it."""
    if supervisor.mode is not Mode.STANDBY:
        return f"arming needs standby, the mode is {supervisor.mode.value}"
    if blocked := _blocked(causes):
        return blocked
    return _against_demand(pedal)


def _against_demand(pedal: Pedal) -> str:
    if pedal.asked is None:
        return "there is no fresh demand"
    if _throttle_asked(pedal.asked):
        return "the demanded throttle is not 0"
    if pedal.zero_for_ns is None or pedal.zero_for_ns < RELEASED_MS * _NS_PER_MS:
        return f"the demanded throttle has not been 0 for {RELEASED_MS} ms"
    if not pedal.independent_directions and directions_differ(pedal.asked):
        return "both controllers must have the same direction"
    if pedal.reverse_pending:
        return "a change of direction is pending"
    return ""


def against_resetting(
    supervisor: Supervisor, causes: Causes, asked: Asked, level: FaultClass
) -> str:
    """Why FAULT cannot be left now at this level; empty where nothing speaks against it."""
    latch = supervisor.latch
    if latch is None or supervisor.mode is not Mode.FAULT:
        return "nothing is latched"
    if latch.fault_class is FaultClass.SERVICE and level is not FaultClass.SERVICE:
        return f"{latch.reason} needs a reset at service level"
    if blocked := _blocked(causes):
        return blocked
    if _throttle_asked(asked):
        return "the demanded throttle is not 0"
    return ""


def _blocked(causes: Causes) -> str:
    blocks = causes.having(BLOCKING)
    return f"{blocks[0].finding} stands or stood a moment ago" if blocks else ""


def _throttle_asked(asked: Asked) -> bool:
    return asked is not None and any(one.throttle_pct > 0 for one in asked.values())
