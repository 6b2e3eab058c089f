"""What the operator asks of the motors."""

from dataclasses import dataclass
from enum import IntEnum


class PowerMode(IntEnum):
    """The command's power modes; the numbers are the codes on the wire."""

    ECO = 0
    NORMAL = 1
    TURBO = 2
    SAFETY = 3


@dataclass(frozen=True, slots=True)
class ControllerDemand:
    """What is asked of one controller.

    throttle_pct and brake_pct 0..100, speed_limit_rpm 0..12000, power_limit_w 0..60000.
    """

    throttle_pct: float = 0.0
    brake_pct: float = 0.0
    power_mode: PowerMode = PowerMode.ECO
    motor_reverse: bool = False
    regen_brake: bool = False
    speed_limit_rpm: float = 12000.0
    power_limit_w: float = 60000.0
