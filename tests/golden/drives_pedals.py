"""Golden drives of the pedals: throttle, brake, direction, and every limit and slew of them."""

from dataclasses import replace

from tests.golden.drives_vehicle import code
from tests.golden.scripted_drive import CRUISE, MS, RELEASED, ScriptedDrive
from tests.golden.scripts import golden
from vcu_gateway.core import calls
from vcu_gateway.core.demand import CONTROLLERS, PowerMode
from vcu_gateway.core.supervisor import FaultClass, Mode

PEDALS_TOGETHER = (
    *((25.0, 30.0), (25.1, 5.0), (25.1, 5.1), (25.1, 0.0), (5.0, 0.0)),
    *((4.9, 0.0), (60.0, 0.0), (60.0, 10.0), (0.0, 10.0), (30.0, 0.0)),
)
"""Throttle and brake in percent, at both limits and beside them."""


@golden()
def pedals(drive: ScriptedDrive) -> None:
    """Throttle, brake, regeneration, power modes and limits, up and down along every slew."""
    drive.start_driving(throttle_pct=100)
    drive.run(3000)
    for changes in (
        {"throttle_pct": 5.0}, {"throttle_pct": 60.0, "power_mode": PowerMode.TURBO},
        {"brake_pct": 30.0, "throttle_pct": 0.0, "regen_brake": True},
        {"throttle_pct": 50.0, "speed_limit_rpm": 2000.0}, {"speed_limit_rpm": 300.0},
        {"speed_limit_rpm": 9000.0}, {"power_limit_w": 8000.0, "throttle_pct": 70.0},
        {"power_limit_w": 50000.0}, {"power_mode": PowerMode.ECO}, {"power_mode": PowerMode.SAFETY},
        {"throttle_pct": 40.0},
    ):  # fmt: skip
        drive.demand(**changes)
        drive.run(900)
    drive.demanded = {"PCU1": CRUISE, "PCU2": replace(CRUISE, throttle_pct=10.0)}
    drive.run(700)


@golden()
def power_modes(drive: ScriptedDrive) -> None:
    """PowerMode waits for released throttle, of each controller; one rise reaches PCU1 alone."""
    eco, turbo = PowerMode.ECO, PowerMode.TURBO
    drive.start_driving(power_mode=eco)
    drive.demand(power_mode=turbo)
    drive.run(300)
    for second_pct in (5.1, 4.8):
        released = replace(CRUISE, throttle_pct=4.8, power_mode=turbo)
        drive.demanded = {"PCU1": released, "PCU2": replace(released, throttle_pct=second_pct)}
        drive.run(300)
    drive.demand(power_mode=PowerMode.SAFETY)
    drive.run(200)
    drive.demanded = {"PCU1": CRUISE, "PCU2": replace(CRUISE, power_mode=PowerMode.SAFETY)}
    drive.run(300)
    drive.demand()
    drive.run(300)
    drive.demand(power_mode=eco, throttle_pct=0)
    drive.run(200)
    drive.taken = ("PCU1",)
    drive.demand(power_mode=turbo, throttle_pct=60)
    drive.ticks(1)
    drive.taken = CONTROLLERS
    drive.run(500)


@golden(24)
def two_tracks(drive: ScriptedDrive) -> None:
    """Pedal tracks that differ by 10 % and by 10.1 %, for 100 ms and for longer."""
    drive.start_driving(throttle_track2_pct=30.0)
    for track2_pct, for_ms in ((40.0, 300), (40.1, 50), (30.0, 200), (40.1, 100), (30.0, 200),
                               (40.1, 150), (30.0, 300), (19.9, 300)):  # fmt: skip
        drive.demand(throttle_track2_pct=track2_pct)
        drive.run(for_ms)
    for throttle_pct, track2_pct in ((5.0, 5.0), (4.9, 5.0), (5.0, 4.9), (4.9, 4.9), (30.0, 30.0)):
        drive.demand(throttle_pct=throttle_pct, throttle_track2_pct=track2_pct)
        drive.run(300)
    for made_before_ms in (0, 99, 101, 150):
        drive.offer(
            replace(CRUISE, throttle_track2_pct=50.0), made_ns=drive.now_ns - made_before_ms * MS
        )
        drive.run(150)


@golden(24, config="demand: {second_track_required: true}")
def second_track_required(drive: ScriptedDrive) -> None:
    """A configuration that wants the pedal's second track, with and without one."""
    drive.run(2500)
    drive.demanded = replace(RELEASED, throttle_track2_pct=0.0)
    drive.run(1500)
    drive.arm()
    drive.demanded = replace(CRUISE, throttle_track2_pct=30.0)
    drive.run(700)
    drive.demanded = CRUISE
    drive.run(500)


@golden(25)
def brake_over_throttle(drive: ScriptedDrive) -> None:
    """Brake and throttle together, at and beside both limits; it ends with a released throttle."""
    drive.start_driving()
    for throttle_pct, brake_pct in PEDALS_TOGETHER:
        drive.demand(throttle_pct=throttle_pct, brake_pct=brake_pct)
        drive.run(400)
    drive.offer(replace(CRUISE, throttle_pct=60.0, brake_pct=10.0))
    drive.offer(CRUISE)
    drive.ticks(3)


@golden(26)
def throttle_at_arming(drive: ScriptedDrive) -> None:
    """Arming and resetting with throttle, too soon after it, and in every mode."""
    drive.arm()
    drive.run(500)
    drive.arm()
    drive.until(Mode.STANDBY)
    drive.reset()
    drive.demand(throttle_pct=0.1)
    drive.run(500)
    drive.arm()
    drive.demanded = RELEASED
    for _ in range(14):
        drive.ticks(1)
        if drive.arm().granted:
            break
    drive.run(300)
    drive.arm()
    drive.demand()
    drive.run(700)
    drive.gateway.apply(calls.EmergencyStop())
    drive.run(600)
    drive.reset()
    drive.demanded = RELEASED
    drive.reset(FaultClass.DRIVER)
    for _ in range(30):
        drive.ticks(1)
        drive.reset(FaultClass.DRIVER)
        if drive.reset().granted:
            break
    drive.run(2500)
    drive.demanded = None
    drive.run(600)
    drive.arm()
    drive.run(200)


@golden(27)
def directions(drive: ScriptedDrive) -> None:
    """Reverse asked at speed, at the limit, at standstill; both directions at once."""
    drive.start_driving()
    drive.demand(motor_reverse=True)
    drive.run(600)
    drive.demand(throttle_pct=0, motor_reverse=True, brake_pct=100)
    for raw in (51, 50, 49):
        with drive.broken(code("PCU1_Status2.MotorSpeed", raw)):
            drive.run(400)
    drive.run(3000)
    drive.demand(motor_reverse=True)
    drive.run(1500)
    drive.demand(throttle_pct=0, brake_pct=100)
    drive.run(3500)
    drive.demand()
    drive.run(500)
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.demanded = {"PCU1": RELEASED, "PCU2": replace(RELEASED, motor_reverse=True)}
    drive.run(600)
    drive.arm()
    drive.run(200)


@golden(27, config="demand: {independent_directions: true}")
def independent_directions(drive: ScriptedDrive) -> None:
    """Both directions at once, where the configuration allows it."""
    drive.run(2500)
    turning = {"PCU1": RELEASED, "PCU2": replace(RELEASED, motor_reverse=True)}
    drive.demanded = turning
    drive.run(600)
    drive.arm()
    drive.demanded = {name: replace(one, throttle_pct=10.0) for name, one in turning.items()}
    drive.run(1500)


@golden(28)
def regeneration(drive: ScriptedDrive) -> None:
    """Regeneration with motors at, below and above the least speed, and at an unknown one."""
    drive.start_driving(throttle_pct=60)
    drive.run(2500)
    drive.demand(throttle_pct=0, brake_pct=20, regen_brake=True)
    for raw in (300, 100, 99, 120, 149, 150, 151, 100, 65535, 160):
        with drive.broken(code("PCU2_Status2.MotorSpeed", raw)):
            drive.run(250)
    drive.run(3000)


@golden(config="limits: {regen_min_rpm: 0, throttle_slew_pct_per_s: 40, power_slew_w_per_s: 20000,"
        " power_limit_max_w: 20000, speed_limit_max_rpm: 5000, derated_power_w: 3000}")  # fmt: skip
def other_limits(drive: ScriptedDrive) -> None:
    """Slower slews and lower limits than the defaults, and regeneration at any speed."""
    drive.start_driving(throttle_pct=70)
    drive.run(1500)
    drive.demand(throttle_pct=0, brake_pct=60, regen_brake=True)
    with drive.broken(
        code("BMS_Status.CellUndervoltage", 1), code("BMS_Status.CellOvervoltage", 1)
    ):
        drive.run(1500)
    drive.run(3000)


@golden(config="limits: {speed_slew_rpm_per_s: 20000}")
def speed_limits(drive: ScriptedDrive) -> None:
    """Speed limits down to the least one and below it: each falls along its slew, rises at once."""
    drive.start_driving()
    for limit_rpm in (501, 500, 499, 0, 12000, 600):
        drive.demand(speed_limit_rpm=limit_rpm)
        drive.run(700)
