"""Signal values of each message, from the state of the vehicle, in physical units."""

import random
from collections.abc import Callable, Mapping
from functools import partial

from vcu_gateway.simulator.motor import voltage_level
from vcu_gateway.simulator.vehicle import LEFT, RIGHT, Vehicle

Values = Mapping[str, float]
Source = Callable[[int], Values]
"""Values of the next frame; the argument is how many frames of it were sent before."""

_KM_H_PER_M_S = 3.6
_GRAVITY_M_S2 = 9.81

# Standard deviations of the sensors' noise.
_STEERING_NOISE_DEG = 0.02
_WHEEL_SPEED_NOISE_SHARE = 0.001
_ACCELERATION_NOISE_M_S2 = 0.03
_ANGULAR_RATE_NOISE_DEG_S = 0.05
_ATTITUDE_NOISE_DEG = 0.03
_PACK_VOLTAGE_NOISE_V = 0.01

# The five packs: the middle one is the warmest.
_PACK_OFFSETS_K = (-1.0, -0.3, 0.4, 0.0, -0.7)


def sources(vehicle: Vehicle, noise: random.Random) -> Mapping[str, Source]:
    """The source of each message's values, by message name."""
    sources: dict[str, Source] = {
        "ARD2_SteeringWheel": partial(_steering_wheel, vehicle, noise),
        "BMS_Status": partial(_bms_status, vehicle, noise),
        "BMS_Temperatures": partial(_bms_temperatures, vehicle),
        "IMU_Acceleration": partial(_acceleration, vehicle, noise),
        "IMU_AngularRate": partial(_angular_rate, vehicle, noise),
        "IMU_Attitude": partial(_attitude, vehicle, noise),
    }
    for controller in (LEFT, RIGHT):
        sources[f"{controller}_Status1"] = partial(_status1, vehicle, controller)
        sources[f"{controller}_Status2"] = partial(_status2, vehicle, controller)
    return sources


def _steering_wheel(vehicle: Vehicle, noise: random.Random, _: int) -> Values:
    return {
        "SteeringAngle": vehicle.steering_deg + noise.gauss(0, _STEERING_NOISE_DEG),
        "WheelSpeedFL": _wheel_speed_km_h(vehicle.left_speed_m_s, noise),
        "WheelSpeedFR": _wheel_speed_km_h(vehicle.right_speed_m_s, noise),
    }


def _wheel_speed_km_h(speed_m_s: float, noise: random.Random) -> float:
    """Speed without sign: the sensor has no direction."""
    return abs(speed_m_s) * _KM_H_PER_M_S * (1 + noise.gauss(0, _WHEEL_SPEED_NOISE_SHARE))


def _bms_status(vehicle: Vehicle, noise: random.Random, count: int) -> Values:
    battery = vehicle.battery
    return {
        "PackVoltage": battery.voltage_v + noise.gauss(0, _PACK_VOLTAGE_NOISE_V),
        "SOC": battery.soc_pct,
        "CellOvervoltage": 0,
        "CellUndervoltage": battery.undervoltage_level,
        "DischargeOvercurrent": 0,
        "TemperatureImbalance": 0,
        "Overtemperature": 0,
        "Undertemperature": 0,
        "VoltageImbalance": 0,
        "InternalFault": 0,
        "BatteryState": battery.state,
        "ErrorCode": 0,
        "LifeSignal": count % 2,
    }


def _bms_temperatures(vehicle: Vehicle, _: int) -> Values:
    middle_c = vehicle.battery.temperature_c
    return {
        f"PackTemperature{number}": middle_c + offset_k
        for number, offset_k in enumerate(_PACK_OFFSETS_K, start=1)
    }


def _acceleration(vehicle: Vehicle, noise: random.Random, _: int) -> Values:
    return _noisy(
        noise,
        _ACCELERATION_NOISE_M_S2,
        AccelerationX=vehicle.acceleration_m_s2,
        AccelerationY=vehicle.lateral_acceleration_m_s2,
        AccelerationZ=_GRAVITY_M_S2,
    )


def _angular_rate(vehicle: Vehicle, noise: random.Random, _: int) -> Values:
    return _noisy(
        noise,
        _ANGULAR_RATE_NOISE_DEG_S,
        AngularRateX=vehicle.roll_rate_deg_s,
        AngularRateY=vehicle.pitch_rate_deg_s,
        AngularRateZ=vehicle.yaw_rate_deg_s,
    )


def _attitude(vehicle: Vehicle, noise: random.Random, _: int) -> Values:
    return _noisy(
        noise,
        _ATTITUDE_NOISE_DEG,
        AttitudeX=vehicle.roll_deg,
        AttitudeY=vehicle.pitch_deg,
        AttitudeZ=vehicle.heading_deg,
    )


def _noisy(noise: random.Random, deviation: float, **values: float) -> Values:
    return {name: value + noise.gauss(0, deviation) for name, value in values.items()}


def _status1(vehicle: Vehicle, controller: str, _: int) -> Values:
    motor = vehicle.motors[controller]
    return {
        "PowerMode": motor.order.power_mode,
        "MotorReverse": motor.order.motor_reverse,
        "RegenBrake": motor.order.regen_brake,
        "PowerCut": motor.order.power_cut,
        "Throttle": motor.order.throttle_pct,
        "Brake": motor.order.brake_pct,
        "VoltageLevel": voltage_level(vehicle.battery.voltage_v),
        "CurrentLevel": motor.current_level,
        "TemperatureProtectLevel": motor.temperature_protect_level,
        "FocMode": 1,
        "StatusCode": 0,
        "ControllerTemperature": motor.controller_c,
        "MotorTemperature": motor.motor_c,
    }


def _status2(vehicle: Vehicle, controller: str, _: int) -> Values:
    """BatteryCurrent is positive while the motor draws, negative while it regenerates."""
    motor = vehicle.motors[controller]
    voltage_v = vehicle.battery.voltage_v
    return {
        "BatteryVoltage": voltage_v,
        "BatteryCurrent": motor.power_w / voltage_v,
        "PhaseCurrent": motor.phase_current_a,
        "MotorSpeed": abs(motor.speed_rpm),
    }
