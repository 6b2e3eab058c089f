"""Motor with its controller: torque, speed and warnings from the commands it receives."""

import math
from collections.abc import Mapping

from vcu_gateway.core.commands import Command
from vcu_gateway.core.demand import PowerMode

# Without a command for longer a controller goes to zero torque by itself.
_COMMAND_TIMEOUT_NS = 500_000_000

_PEAK_TORQUE_NM = 30.0
_TORQUE_SHARE = {
    PowerMode.ECO: 0.4,
    PowerMode.NORMAL: 0.7,
    PowerMode.TURBO: 1.0,
    PowerMode.SAFETY: 0.0,
}
_CURRENT_LEVEL = {PowerMode.ECO: 0, PowerMode.NORMAL: 1, PowerMode.TURBO: 2, PowerMode.SAFETY: 0}
_RATED_POWER_W = 12_000.0
_TOP_SPEED_RPM = 5_200.0
_SPEED_BAND_RPM = 200.0  # the torque fades to zero over this much below a speed limit
_REGEN_TORQUE_NM = 12.0
_REGEN_FADE_RPM = 150.0  # below this speed regeneration fades to zero
_TORQUE_PER_AMPERE_NM = 0.12
_EFFICIENCY = 0.9
_COPPER_LOSS_W_PER_NM2 = 0.7

_MOTOR_HEAT_SHARE = 0.7
_MOTOR_HEAT_J_PER_K, _MOTOR_COOLING_S = 8_000.0, 600.0
_CONTROLLER_HEAT_J_PER_K, _CONTROLLER_COOLING_S = 2_000.0, 300.0
_TURBO_OFF_C = {"controller": 85.0, "motor": 110.0}
_SHUTDOWN_C = {"controller": 105.0, "motor": 140.0}

# Upper ends of voltage levels 1 to 4; level 5 lies above the last.
_VOLTAGE_LEVELS_V = (50.0, 56.0, 86.0, 92.0)

_RAD_S_PER_RPM = math.pi / 30


def order_of(values: Mapping[str, float]) -> Command:
    """The order in a command's physical values, by the protocol's signal names.

    Whatever is missing, not a number or unknown makes no torque.
    """

    def at_most(name: str, highest: float) -> float:
        return min(highest, max(0.0, values.get(name, 0.0)))

    mode = values.get("PowerMode")
    return Command(
        power_mode=next((known for known in PowerMode if known == mode), PowerMode.SAFETY),
        motor_reverse=values.get("MotorReverse") == 1,
        regen_brake=values.get("RegenBrake") == 1,
        power_cut=values.get("PowerCut", 1) != 0,
        throttle_pct=at_most("Throttle", 100.0),
        brake_pct=at_most("Brake", 100.0),
        speed_limit_rpm=at_most("SpeedLimit", math.inf),
        power_limit_w=at_most("PowerLimit", math.inf),
    )


class Motor:
    """One motor with its controller.

    Attributes:
        order: what the controller obeys, as its Status1 echoes it.
        speed_rpm: signed, positive when the vehicle rolls forwards.
        torque_nm: signed, positive pushes the vehicle forwards.
        power_w: taken from the battery; negative while it regenerates.
        controller_c, motor_c: temperatures.
        ignores_commands: it goes on with the order that it obeys, without a time-out.
        turned_round: it takes forwards for reverse and reverse for forwards.
    """

    def __init__(self, ambient_c: float) -> None:
        self.order = Command()
        self.speed_rpm = 0.0
        self.torque_nm = 0.0
        self.power_w = 0.0
        self.controller_c = ambient_c
        self.motor_c = ambient_c
        self.ignores_commands = False
        self.turned_round = False
        self._ambient_c = ambient_c
        self._received = Command()
        self._received_ns: int | None = None

    def command(self, order: Command, now_ns: int) -> None:
        """Take an order; it counts from the next step on."""
        self._received, self._received_ns = order, now_ns

    @property
    def current_level(self) -> int:
        """The code of CurrentLevel."""
        return _CURRENT_LEVEL[self.order.power_mode]

    @property
    def temperature_protect_level(self) -> int:
        """0 good, 1 turbo disabled, 2 shut down."""
        if self._hotter_than(_SHUTDOWN_C):
            return 2
        return 1 if self._hotter_than(_TURBO_OFF_C) else 0

    @property
    def phase_current_a(self) -> float:
        """Positive drives, negative brakes, whichever way the motor turns."""
        along = self.torque_nm * self.speed_rpm
        sign = math.copysign(1.0, along) if along else 1.0
        return sign * abs(self.torque_nm) / _TORQUE_PER_AMPERE_NM

    def step(self, now_ns: int, speed_rpm: float, power_available_w: float, dt_s: float) -> None:
        """Make torque for dt_s (s) at this speed, and warm up from what it costs."""
        self.order = self._obeyed(now_ns)
        self.speed_rpm = speed_rpm
        self.torque_nm = self._torque_nm(power_available_w)
        mechanical_w = self.torque_nm * speed_rpm * _RAD_S_PER_RPM
        at_terminals_w = mechanical_w * (_EFFICIENCY if mechanical_w < 0 else 1 / _EFFICIENCY)
        self.power_w = at_terminals_w + _COPPER_LOSS_W_PER_NM2 * self.torque_nm**2
        self._warm(self.power_w - mechanical_w, dt_s)

    def _hotter_than(self, limits_c: Mapping[str, float]) -> bool:
        return self.controller_c > limits_c["controller"] or self.motor_c > limits_c["motor"]

    def _obeyed(self, now_ns: int) -> Command:
        """The order as far as the time-out and the temperatures let it pass."""
        if self.ignores_commands:
            return self.order
        received = self._received
        if self.turned_round:
            received = received._replace(motor_reverse=not received.motor_reverse)
        if self._received_ns is None or now_ns - self._received_ns > _COMMAND_TIMEOUT_NS:
            return Command(motor_reverse=received.motor_reverse)
        level = self.temperature_protect_level
        if level == 1 and received.power_mode is PowerMode.TURBO:
            return received._replace(power_mode=PowerMode.NORMAL)
        return received._replace(power_mode=PowerMode.SAFETY) if level > 1 else received

    def _torque_nm(self, power_available_w: float) -> float:
        order, rpm = self.order, self.speed_rpm
        if order.power_cut:
            return 0.0
        if order.regen_brake and order.brake_pct > 0:
            strength = max(-1.0, min(1.0, rpm / _REGEN_FADE_RPM))
            return -strength * _REGEN_TORQUE_NM * order.brake_pct / 100
        asked_nm = _PEAK_TORQUE_NM * _TORQUE_SHARE[order.power_mode] * order.throttle_pct / 100
        power_w = min(order.power_limit_w, _RATED_POWER_W, power_available_w)
        room_rpm = min(order.speed_limit_rpm, _TOP_SPEED_RPM) - abs(rpm)
        fade = max(0.0, min(1.0, room_rpm / _SPEED_BAND_RPM))
        torque_nm = min(asked_nm, _torque_for_power_nm(power_w, abs(rpm))) * fade
        return -torque_nm if order.motor_reverse else torque_nm

    def _warm(self, loss_w: float, dt_s: float) -> None:
        for_motor_w = loss_w * _MOTOR_HEAT_SHARE
        self.motor_c += dt_s * (
            for_motor_w / _MOTOR_HEAT_J_PER_K - (self.motor_c - self._ambient_c) / _MOTOR_COOLING_S
        )
        self.controller_c += dt_s * (
            (loss_w - for_motor_w) / _CONTROLLER_HEAT_J_PER_K
            - (self.controller_c - self._ambient_c) / _CONTROLLER_COOLING_S
        )


def voltage_level(battery_voltage_v: float) -> int:
    """The code of VoltageLevel, 1 to 5."""
    return 1 + sum(battery_voltage_v > end_v for end_v in _VOLTAGE_LEVELS_V)


def _torque_for_power_nm(power_w: float, speed_rpm: float) -> float:
    """The torque that takes this power from the battery.

    Solves power = torque * speed / efficiency + copper loss * torque squared.
    """
    per_nm_w = speed_rpm * _RAD_S_PER_RPM / _EFFICIENCY
    root = math.sqrt(per_nm_w**2 + 4 * _COPPER_LOSS_W_PER_NM2 * power_w)
    return (root - per_nm_w) / (2 * _COPPER_LOSS_W_PER_NM2)
