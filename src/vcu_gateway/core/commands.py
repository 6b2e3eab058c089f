"""The physical values of a command frame; forgetting something yields zero torque."""

from collections.abc import Mapping
from dataclasses import dataclass

from vcu_gateway.core.demand import ControllerDemand, PowerMode

CONTROLLERS = ("PCU1", "PCU2")


@dataclass(frozen=True, slots=True)
class Command:
    """One command frame in physical values; the defaults are SAFETY.md's ZERO_TORQUE.

    The speed limit's default is the protocol's maximum: a limit of 0 could brake hard.
    """

    power_mode: PowerMode = PowerMode.SAFETY
    motor_reverse: bool = False
    regen_brake: bool = False
    power_cut: bool = False
    throttle_pct: float = 0.0
    brake_pct: float = 0.0
    speed_limit_rpm: float = 12000.0
    power_limit_w: float = 0.0

    def signals(self) -> Mapping[str, float]:
        """The values by the protocol's signal names."""
        return {
            "PowerMode": self.power_mode,
            "MotorReverse": self.motor_reverse,
            "RegenBrake": self.regen_brake,
            "PowerCut": self.power_cut,
            "Throttle": self.throttle_pct,
            "Brake": self.brake_pct,
            "SpeedLimit": self.speed_limit_rpm,
            "PowerLimit": self.power_limit_w,
        }


def message_name(controller: str) -> str:
    """The command message of this controller."""
    return f"VCU_{controller}_Command"


def from_demand(
    demand: ControllerDemand, speed_limit_max_rpm: float, power_limit_max_w: float
) -> Command:
    """The command that grants a demand in full, within the configured maxima."""
    return Command(
        power_mode=demand.power_mode,
        motor_reverse=demand.motor_reverse,
        regen_brake=demand.regen_brake,
        throttle_pct=demand.throttle_pct,
        brake_pct=demand.brake_pct,
        speed_limit_rpm=min(demand.speed_limit_rpm, speed_limit_max_rpm),
        power_limit_w=min(demand.power_limit_w, power_limit_max_w),
    )
