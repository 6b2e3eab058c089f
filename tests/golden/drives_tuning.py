"""Golden drives of curves, drive modes and the slip limiter."""

from dataclasses import replace

from tests.golden.drives_vehicle import code
from tests.golden.scripted_drive import RELEASED, ScriptedDrive
from tests.golden.scripts import golden
from vcu_gateway.core import calls
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import PowerMode
from vcu_gateway.core.supervisor import FaultClass, Mode

CURVES = """
vehicle: {motor_rpm_per_kmh: 85.3}
limits: {power_limit_max_w: 14000, derated_power_w: 4000}
curves:
  power_limit_w:
    by_motor_temperature_c: [[95, 14000], [110, 6000], [125, 0]]
    by_controller_temperature_c: [[75, 14000], [95, 2000]]
    by_pack_temperature_max_c: [[45, 14000], [55, 4000], [60, 0]]
    by_pack_temperature_min_c: [[-10, 3000], [5, 14000]]
    by_soc_pct: [[3, 1500], [10, 5000], [25, 14000]]
    by_battery_voltage_v: [[40, 1000], [46, 14000]]
  brake_pct:
    by_soc_pct: [[90, 100], [98, 0]]
    by_pack_temperature_max_c: [[45, 100], [60, 0]]
    by_controller_temperature_c: [[75, 100], [95, 0]]
    by_pack_temperature_min_c: [[0, 0], [10, 100]]
    by_motor_speed_rpm: [[150, 0], [600, 100]]
  speed_limit_rpm:
    by_soc_pct: [[5, 1700], [15, 12000]]
"""
MODES = """
vehicle: {motor_rpm_per_kmh: 85.3}
drive_modes:
  start: eco
  modes:
    eco:
      throttle_pct: {by_pedal_pct: [[0, 0], [40, 20], [80, 55], [100, 80]]}
      throttle_rise_pct_per_s: {by_speed_kmh: [[0, 30], [25, 80]]}
      power_mode_max: normal
      power_limit_w: 8000
      speed_limit_kmh: 45
    sport: {}
    rain:
      throttle_pct:
        by_pedal_pct: [[0, 0], [50, 20], [100, 60]]
        by_speed_kmh: [[0, 30], [60, 100]]
      brake_max_pct: 30
    valet: {power_mode_max: eco, speed_limit_kmh: 15, left_by_service: true}
"""
SLIP = "vehicle: {motor_rpm_per_kmh: 85.3}\nlaws: {slip: {wait_ms: 150}}"
FULL = {"throttle_pct": 100, "power_mode": PowerMode.TURBO}
TEMPERATURE_OFFSET = 50


def heated(drive: ScriptedDrive, signal: str, *raws: int) -> None:
    """Drive, then brake, at each of these codes."""
    for raw in raws:
        with drive.broken(code(signal, raw)):
            drive.demand(**FULL)
            drive.run(700)
            drive.demand(throttle_pct=0, brake_pct=80, regen_brake=True)
            drive.run(500)
    drive.demand(**FULL)
    drive.run(1000)


@golden(config=CURVES)
def curves_of_motors(drive: ScriptedDrive) -> None:
    """Temperatures of motors and controllers along their curves, one motor alone, one unknown."""
    drive.start_driving(**FULL)
    heated(drive, "PCU1_Status1.MotorTemperature", 94, 96, 110, 124, 125, 255)
    heated(drive, "PCU2_Status1.ControllerTemperature", 75, 85, 95, 150, 151)
    with drive.broken({"fault": "silence", "of": "PCU1_Status1"}):
        drive.run(3000)
    drive.run(2000)


@golden(config=CURVES)
def curves_of_the_battery(drive: ScriptedDrive) -> None:
    """Charge, temperatures and voltage of the battery along their curves, and unknown."""
    drive.start_driving(**FULL)
    heated(drive, "BMS_Status.SOC", 99, 94, 25, 10, 5, 2)
    drive.run(1500)
    for celsius in (-11, -5, 5, 45, 50, 60):
        heated(drive, "BMS_Temperatures.PackTemperature3", celsius + TEMPERATURE_OFFSET)
    heated(drive, "BMS_Temperatures.PackTemperature5", 251)
    with drive.broken({"fault": "silence", "of": "BMS_Temperatures"}):
        drive.run(2500)
    heated(drive, "PCU2_Status2.BatteryVoltage", 45 * 128, 43 * 128, 40 * 128, 30 * 128)


@golden(config=CURVES)
def curves_reloaded(drive: ScriptedDrive) -> None:
    """Motors 40 and 41 °C apart; a stricter curve taken while driving, a looser one refused."""
    drive.start_driving(throttle_pct=30)
    cool = code("PCU2_Status1.MotorTemperature", 30)
    for celsius in (70, 71):
        with drive.broken(cool, code("PCU1_Status1.MotorTemperature", celsius)):
            drive.run(1500)
    with drive.broken(code("PCU1_Status1.MotorTemperature", 110)):
        for watts in (5000, 5001, 2000):
            by_motor = Curve(((95.0, 14000.0), (110.0, float(watts)), (125.0, 0.0)))
            settings = drive.gateway.settings
            curves = {**settings.tuning.curves, "power_limit_w.by_motor_temperature_c": by_motor}
            tuning = replace(settings.tuning, curves=curves)
            drive.gateway.apply(calls.ReloadSettings(replace(settings, tuning=tuning)))
            drive.run(1000)


@golden(config=CURVES)
def curves_outside_active(drive: ScriptedDrive) -> None:
    """Limits return at once while nothing is driven; braking down to standstill."""
    drive.until(Mode.STANDBY)
    with drive.broken(code("PCU1_Status1.MotorTemperature", 120)):
        drive.start_driving(**FULL)
        drive.break_with(code("PCU1_Status1.MotorTemperature", 120))
        drive.run(1200)
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.run(1000)
    drive.start_driving(**FULL)
    drive.run(2000)
    drive.demand(throttle_pct=0, brake_pct=100, regen_brake=True)
    drive.run(4000)


def ask(drive: ScriptedDrive, mode: str, level: FaultClass = FaultClass.DRIVER) -> None:
    drive.gateway.apply(calls.SetDriveMode(mode, level, drive.now_ns))


@golden(config=MODES)
def drive_modes(drive: ScriptedDrive) -> None:
    """Every mode, asked for at full pedal, released and standing; refused and unknown ones."""
    drive.start_driving(**FULL)
    drive.run(2500)
    for mode in ("sport", "rain", "sprot", "eco", "sport", "valet"):
        ask(drive, mode)
        drive.run(900)
        drive.demand(throttle_pct=4.9, power_mode=PowerMode.TURBO)
        drive.run(200)
        drive.demand(**FULL)
        drive.run(1200)
    ask(drive, "sport")
    ask(drive, "sport", FaultClass.SERVICE)
    drive.run(500)
    drive.demanded = RELEASED
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.run(500)
    ask(drive, "valet")
    drive.arm()  # its speed limit has not come down
    drive.run(300)
    drive.arm()
    drive.start_driving(**FULL)


@golden(config=MODES)
def modes_over_speed(drive: ScriptedDrive) -> None:
    """Throttle and rise over speed; front wheels saturated, silent and back."""
    drive.gateway.apply(calls.BeginInMode("rain"))
    drive.start_driving(**FULL)
    drive.run(5000)
    for name in ("WheelSpeedFL", "WheelSpeedFR"):
        with drive.broken(code(f"ARD2_SteeringWheel.{name}", 65535)):
            drive.run(600)
    with drive.broken({"fault": "silence", "of": "ARD2"}):
        drive.run(1500)
    drive.run(800)


@golden(config=SLIP)
def slip(drive: ScriptedDrive) -> None:
    """Ice under both wheels, under one, and without the front wheels' speed."""
    drive.start_driving(**FULL)
    drive.run(2000)
    with drive.broken({"fault": "slippery", "friction": 0.1}):
        drive.run(2500)
    drive.run(2000)
    with drive.broken({"fault": "slippery", "controller": "PCU1", "friction": 0.1}):
        drive.run(1500)
        drive.break_with(
            {"fault": "slippery", "controller": "PCU1", "friction": 0.1},
            {"fault": "silence", "of": "ARD2"},
        )
        drive.run(1000)
    drive.demand(throttle_pct=0)
    drive.run(700)
    drive.demand(**FULL)
    drive.run(1500)
