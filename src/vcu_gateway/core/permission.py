"""Whether a request may be granted: the first reason against it, as a sentence."""

from collections.abc import Mapping

from vcu_gateway.core.causes import BLOCKING, Causes
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.supervisor import FaultClass, Mode, Supervisor

Asked = Mapping[str, ControllerDemand] | None


def against_arming(
    supervisor: Supervisor, causes: Causes, asked: Asked, reverse_pending: bool
) -> str:
    """Why ACTIVE cannot be entered now; empty where nothing speaks against it.

    `asked` is None without a fresh demand.
    """
    if supervisor.mode is not Mode.STANDBY:
        return f"arming needs standby, the mode is {supervisor.mode.value}"
    if blocked := _blocked(causes):
        return blocked
    if asked is None:
        return "there is no fresh demand"
    if _throttle_asked(asked):
        return "the demanded throttle is not 0"
    if reverse_pending:
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
