"""What the throttle waits for, in sentences."""

from collections.abc import Mapping

from vcu_gateway.core.commands import Commander
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.pedals import ThrottleHold
from vcu_gateway.core.settings import Settings


def waits(
    commander: Commander,
    asked: Mapping[str, ControllerDemand] | None,
    speeds_rpm: tuple[float | None, ...],
    settings: Settings,
) -> list[str]:
    """Why the throttle is 0 although it is asked for; `asked` is None without a fresh demand."""
    found = []
    if latched := commander.pedals.latched:
        reasons = ", ".join(hold.value for hold in ThrottleHold if hold in latched)
        found.append(f"throttle 0 until released below 5 %: {reasons}")
    if asked is None:
        return found
    if commander.reverse_pending(asked):
        found.append(_turning(asked, speeds_rpm, settings.direction_change_rpm))
    safety = [name for name, one in asked.items() if one.power_mode is PowerMode.SAFETY]
    if safety:
        found.append(f"throttle 0 in power mode safety ({' and '.join(safety)})")
    return found


def _turning(
    asked: Mapping[str, ControllerDemand], speeds_rpm: tuple[float | None, ...], limit_rpm: float
) -> str:
    """What a change of direction waits for; after it nothing but the next tick is missing."""
    speeds = dict(zip(asked, speeds_rpm, strict=True))
    unknown = [name for name, speed in speeds.items() if speed is None]
    fast = [name for name, speed in speeds.items() if speed is not None and speed >= limit_rpm]
    sentence = "throttle 0 until the direction changes"
    if unknown:
        sentence += f"; speed unknown of {' and '.join(unknown)}"
    if fast:
        sentence += f"; not below {limit_rpm:g} rpm: {' and '.join(fast)}"
    return sentence
