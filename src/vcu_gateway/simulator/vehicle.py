"""Vehicle model: two motors, tyres, battery, driving resistance and body movements.

Axes as in ISO 8855: x forwards, y left, z up; a positive steering angle turns left.
"""

import math
from collections.abc import Iterable, Mapping

from vcu_gateway.simulator.motor import Motor, order_of
from vcu_gateway.units import NS_PER_S

_CAPACITY_AH = 50.0
_EMPTY_V, _FULL_V = 62.0, 82.0
RESISTANCE_OHM = 0.02
_HEAT_J_PER_K, _COOLING_S = 30_000.0, 1_200.0
_IDLE_CURRENT_A = 2.0

# State of charge below which CellUndervoltage is 1, 2, 3.
_UNDERVOLTAGE_SOC_PCT = (15.0, 5.0, 2.0)


class Battery:
    """The traction battery.

    Attributes:
        soc_pct: state of charge, 0..100.
        voltage_v: at the terminals, under load.
        current_a: positive while it discharges, negative while it is charged.
        temperature_c: of its middle.
    """

    def __init__(
        self, soc_pct: float, ambient_c: float, speedup: float, resistance_ohm: float
    ) -> None:
        """Start at rest; charge flows `speedup` times as fast as it really would."""
        self.soc_pct = min(100.0, max(0.0, soc_pct))
        self.current_a = 0.0
        self.temperature_c = ambient_c
        self.voltage_v = self._open_circuit_v
        self._ambient_c = ambient_c
        self._speedup = speedup
        self._resistance_ohm = resistance_ohm

    @property
    def undervoltage_level(self) -> int:
        """The code of CellUndervoltage."""
        return sum(self.soc_pct < limit_pct for limit_pct in _UNDERVOLTAGE_SOC_PCT)

    @property
    def discharge_relay_closed(self) -> bool:
        """False where the battery management has cut the motors off (undervoltage level 3)."""
        return self.undervoltage_level < len(_UNDERVOLTAGE_SOC_PCT)

    @property
    def state(self) -> int:
        """The code of BatteryState: 0 idle, 1 charging, 2 discharging."""
        if abs(self.current_a) < _IDLE_CURRENT_A:
            return 0
        return 1 if self.current_a < 0 else 2

    def step(self, power_w: float, dt_s: float) -> None:
        """Deliver this power (negative charges) for dt_s (s)."""
        open_v, ohm = self._open_circuit_v, self._resistance_ohm
        # power = (open_v - resistance * current) * current, the root of the lower current
        root_v2 = max(0.0, open_v**2 - 4 * ohm * power_w)
        self.current_a = (open_v - math.sqrt(root_v2)) / (2 * ohm)
        self.voltage_v = open_v - ohm * self.current_a
        used_pct = 100 * self.current_a * dt_s * self._speedup / (_CAPACITY_AH * 3_600)
        self.soc_pct = min(100.0, max(0.0, self.soc_pct - used_pct))
        heat_w = ohm * self.current_a**2
        cooling_k_per_s = (self.temperature_c - self._ambient_c) / _COOLING_S
        self.temperature_c += dt_s * (heat_w / _HEAT_J_PER_K - cooling_k_per_s)

    @property
    def _open_circuit_v(self) -> float:
        return _EMPTY_V + (_FULL_V - _EMPTY_V) * self.soc_pct / 100


LEFT, RIGHT = "PCU1", "PCU2"
"""The controllers, by the rear wheel that their motor drives."""

STEP_NS = 10_000_000
_STEP_S = STEP_NS / NS_PER_S
_CATCH_UP_NS = 1_000_000_000

_AMBIENT_C = 25.0
_MASS_KG = 350.0
_WHEEL_RADIUS_M = 0.28
_GEAR_RATIO = 9.0
_WHEELBASE_M, _TRACK_M = 1.6, 1.1
_ROLLING_RESISTANCE_N = 50.0
_AIR_DRAG_N_PER_M2_S2 = 0.42
_FRICTION_BRAKE_N = 2_500.0
_AUXILIARY_POWER_W = 60.0
_RPM_PER_M_S = 30 / math.pi * _GEAR_RATIO / _WHEEL_RADIUS_M

_DRY_FRICTION = 0.9
_WHEEL_INERTIA_KG_M2 = 1.5
_REAR_SHARE = 0.55
_WHEEL_LOAD_N = _MASS_KG * 9.81 * _REAR_SHARE / 2
_TYRE_SHAPE, _TYRE_STIFFNESS = 1.5, 8.0
_LEAST_SPEED_M_S = 1.5
# A tyre is stiff at walking pace: one step of the vehicle would overshoot.
_TYRE_STEPS = 10

_WIGGLE_DEG, _WIGGLE_PERIOD_S = 12.0, 8.0
_STEERING_LIMIT_DEG, _STEERING_RATIO = 45.0, 10.0
_LANE_KEEPING = 0.5  # degrees of steering against each degree of heading
_LANE_KEEPING_SPEED_M_S = 2.0

_ROLL_DEG_PER_M_S2, _PITCH_DEG_PER_M_S2 = 0.6, -0.5
_BODY_LAG_S = 0.2


class DrivenWheel:
    """Wheel of a motor, with its inertia and a tyre that slips where it is asked for too much.

    Attributes:
        speed_m_s: of its circumference, signed.
        friction: of tyre and road; None: it never slips.
        force_n: what it pushes the vehicle with.
    """

    def __init__(self) -> None:
        self.speed_m_s = 0.0
        self.friction: float | None = None
        self.force_n = 0.0

    def step(self, road_m_s: float, torque_nm: float, dt_s: float) -> None:
        """Turn for dt_s (s) with this torque of the wheel over a road of this speed."""
        pull_n = torque_nm / _WHEEL_RADIUS_M
        if self.friction is None:
            self.speed_m_s, self.force_n = road_m_s, pull_n
            return
        inertia_kg, pushed_n = _WHEEL_INERTIA_KG_M2 / _WHEEL_RADIUS_M**2, 0.0
        for _ in range(_TYRE_STEPS):
            force_n = self._tyre_n(road_m_s, self.friction)
            self.speed_m_s += (pull_n - force_n) / inertia_kg * dt_s / _TYRE_STEPS
            pushed_n += force_n
        self.force_n = pushed_n / _TYRE_STEPS

    def _tyre_n(self, road_m_s: float, friction: float) -> float:
        """Force of the tyre: it grows with the slip, and falls beyond the largest."""
        slip_m_s = self.speed_m_s - road_m_s
        slip = slip_m_s / max(abs(road_m_s), abs(self.speed_m_s), _LEAST_SPEED_M_S)
        grip = math.sin(_TYRE_SHAPE * math.atan(_TYRE_STIFFNESS * slip))
        return friction * _WHEEL_LOAD_N * grip


class Vehicle:
    """The vehicle at one instant; `advance` moves it on, in steps of STEP_NS.

    The steps lie on a grid from start_ns on, so that what happens depends on the commands
    and their times and not on how often `advance` is called.

    Attributes:
        speed_m_s: signed, positive forwards; acceleration_m_s2: its change.
        steering_deg: at the steering wheel, -45..45.
        yaw_rate_deg_s, roll_rate_deg_s, pitch_rate_deg_s, heading_deg, roll_deg, pitch_deg:
            motion and attitude of the body; the driver keeps the heading near 0.
        motors, wheels: by controller name; wheels are those that the motors drive.
        brake_pedal_pct: of the driver's foot, for the friction brake; None: it is what the
            controllers are commanded.
    """

    def __init__(
        self,
        start_ns: int,
        soc_pct: float = 80.0,
        battery_speedup: float = 1.0,
        battery_resistance_ohm: float = RESISTANCE_OHM,
    ) -> None:
        """Stand still at start_ns; battery_speedup makes the charge drain visibly in a demo."""
        self.start_ns = start_ns
        self.speed_m_s = 0.0
        self.acceleration_m_s2 = 0.0
        self.steering_deg = 0.0
        self.yaw_rate_deg_s = self.roll_rate_deg_s = self.pitch_rate_deg_s = 0.0
        self.heading_deg = self.roll_deg = self.pitch_deg = 0.0
        self.motors = {LEFT: Motor(_AMBIENT_C), RIGHT: Motor(_AMBIENT_C)}
        self.wheels = {LEFT: DrivenWheel(), RIGHT: DrivenWheel()}
        self.brake_pedal_pct: float | None = None
        self.battery = Battery(soc_pct, _AMBIENT_C, battery_speedup, battery_resistance_ohm)
        self._stepped_ns = start_ns

    def command(self, controller: str, values: Mapping[str, float], now_ns: int) -> None:
        """Give a controller its command's physical values; KeyError for an unknown one."""
        self.advance(now_ns)
        self.motors[controller].command(order_of(values), now_ns)

    def slip_on(self, controllers: Iterable[str], friction: float | None) -> None:
        """Give these wheels a road of this friction; None is the dry one again."""
        for name in controllers:
            self.wheels[name].friction = _DRY_FRICTION if friction is None else friction

    def advance(self, now_ns: int) -> None:
        """Move on to now_ns; beyond a second of catching up, the time is left out."""
        missed_steps = (now_ns - self._stepped_ns - _CATCH_UP_NS) // STEP_NS
        self._stepped_ns += max(0, missed_steps) * STEP_NS
        while self._stepped_ns + STEP_NS <= now_ns:
            self._stepped_ns += STEP_NS
            self._step(self._stepped_ns)

    @property
    def elapsed_s(self) -> float:
        return (self._stepped_ns - self.start_ns) / NS_PER_S

    @property
    def lateral_acceleration_m_s2(self) -> float:
        """Positive in a left turn."""
        return self.speed_m_s * math.radians(self.yaw_rate_deg_s)

    @property
    def left_speed_m_s(self) -> float:
        """Speed of the left wheels, slower in a left turn."""
        return self.speed_m_s - self._half_difference_m_s

    @property
    def right_speed_m_s(self) -> float:
        """Speed of the right wheels, faster in a left turn."""
        return self.speed_m_s + self._half_difference_m_s

    @property
    def _half_difference_m_s(self) -> float:
        return math.radians(self.yaw_rate_deg_s) * _TRACK_M / 2

    def _step(self, now_ns: int) -> None:
        self._steer((now_ns - self.start_ns) / NS_PER_S)
        self._drive(now_ns)
        self._roll_on()
        self._lean()

    def _steer(self, elapsed_s: float) -> None:
        """Steering angle: a slow sine, and a correction towards heading 0."""
        wiggle_deg = _WIGGLE_DEG * math.sin(2 * math.pi * elapsed_s / _WIGGLE_PERIOD_S)
        rolling = _within(self.speed_m_s / _LANE_KEEPING_SPEED_M_S, 1.0)
        correction_deg = _LANE_KEEPING * self.heading_deg * rolling
        self.steering_deg = _within(wiggle_deg - correction_deg, _STEERING_LIMIT_DEG)
        road_wheel_rad = math.radians(self.steering_deg / _STEERING_RATIO)
        self.yaw_rate_deg_s = math.degrees(self.speed_m_s * math.tan(road_wheel_rad) / _WHEELBASE_M)
        self.heading_deg += self.yaw_rate_deg_s * _STEP_S

    def _drive(self, now_ns: int) -> None:
        available_w = math.inf if self.battery.discharge_relay_closed else 0.0
        road_m_s = {LEFT: self.left_speed_m_s, RIGHT: self.right_speed_m_s}
        for name, motor in self.motors.items():
            wheel = self.wheels[name]
            turning_m_s = road_m_s[name] if wheel.friction is None else wheel.speed_m_s
            motor.step(now_ns, turning_m_s * _RPM_PER_M_S, available_w, _STEP_S)
            wheel.step(road_m_s[name], motor.torque_nm * _GEAR_RATIO, _STEP_S)
        drawn_w = sum(motor.power_w for motor in self.motors.values())
        self.battery.step(drawn_w + _AUXILIARY_POWER_W, _STEP_S)

    def _roll_on(self) -> None:
        before_m_s = self.speed_m_s
        push_n = sum(wheel.force_n for wheel in self.wheels.values())
        pushed_m_s = before_m_s + push_n / _MASS_KG * _STEP_S
        # Friction holds back and never turns the motion round.
        held_back_m_s = self._resistance_n() / _MASS_KG * _STEP_S
        rest_m_s = max(0.0, abs(pushed_m_s) - held_back_m_s)
        self.speed_m_s = math.copysign(rest_m_s, pushed_m_s)
        self.acceleration_m_s2 = (self.speed_m_s - before_m_s) / _STEP_S

    def _resistance_n(self) -> float:
        """Rolling, air and friction brake; the brake by the foot, else by the highest command."""
        pedal_pct = self.brake_pedal_pct
        if pedal_pct is None:
            pedal_pct = max(motor.order.brake_pct for motor in self.motors.values())
        air_n = _AIR_DRAG_N_PER_M2_S2 * self.speed_m_s**2
        return _ROLLING_RESISTANCE_N + air_n + _FRICTION_BRAKE_N * pedal_pct / 100

    def _lean(self) -> None:
        """The body leans out of a turn and squats, with a little lag."""
        roll_to_deg = _ROLL_DEG_PER_M_S2 * self.lateral_acceleration_m_s2
        pitch_to_deg = _PITCH_DEG_PER_M_S2 * self.acceleration_m_s2
        self.roll_rate_deg_s = (roll_to_deg - self.roll_deg) / _BODY_LAG_S
        self.pitch_rate_deg_s = (pitch_to_deg - self.pitch_deg) / _BODY_LAG_S
        self.roll_deg += self.roll_rate_deg_s * _STEP_S
        self.pitch_deg += self.pitch_rate_deg_s * _STEP_S


def _within(value: float, limit: float) -> float:
    return max(-limit, min(limit, value))
