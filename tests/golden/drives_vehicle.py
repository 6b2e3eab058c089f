"""Golden drives of what battery, controllers and sensors say."""

from tests.golden.scripted_drive import MS, ScriptedDrive, Step
from tests.golden.scripts import golden
from vcu_gateway.core.demand import PowerMode
from vcu_gateway.core.supervisor import FaultClass, Mode


def code(signal: str, raw: int) -> Step:
    """This code in every frame."""
    return {"fault": "set", "signal": signal, "raw": raw}


def each_code(drive: ScriptedDrive, signal: str, raws: range, for_ms: int = 600) -> None:
    """Drive, and meet each code in turn."""
    for raw in raws:
        drive.start_driving(brake_pct=0)
        with drive.broken(code(signal, raw)):
            drive.run(for_ms)
        drive.run(1200)


@golden(1, 2, 20)
def lengths(drive: ScriptedDrive) -> None:
    """Every message with each length but eight, and values beyond their range."""
    drive.start_driving()
    for can_id in (0x1808D0F4, 0x0809D0A7, 0x0808D0A7, 0x040AD092):
        for length in (*range(8), 9, 12, 16, 64):
            drive.receive(can_id, bytes(length))
        drive.ticks(1)
    for signal, raw in (("BMS_Status.SOC", 102), ("PCU1_Status2.BatteryVoltage", 65535)):
        with drive.broken(code(signal, raw)):
            drive.run(300)
    with drive.broken({"fault": "shorten", "of": "PCU1_Status2", "length_bytes": 7}):
        drive.run(400)


@golden(14)
def overvoltage(drive: ScriptedDrive) -> None:
    """Cell overvoltage 1, 2, 3 while braking at speed; level 3 stays until a restart."""
    drive.start_driving(throttle_pct=80)
    drive.run(4000)
    for raw in (0, 1, 0, 2, 0, 3, 0):
        drive.demand(throttle_pct=20, brake_pct=40, regen_brake=True)
        with drive.broken(code("BMS_Status.CellOvervoltage", raw)):
            drive.run(800)
        drive.demand(throttle_pct=80)
        drive.run(1400)


@golden(15)
def undervoltage(drive: ScriptedDrive) -> None:
    """Cell undervoltage 1, 2, 3: power along its slew, FAULT for the driver, for the service."""
    drive.start_driving(throttle_pct=60)
    for raw in (1, 2):
        with drive.broken(code("BMS_Status.CellUndervoltage", raw)):
            drive.run(900)
            drive.reset()
        drive.run(1300)
        drive.start_driving()
    drive.break_with(code("BMS_Status.CellUndervoltage", 3))
    drive.run(600)
    drive.break_with()
    drive.run(1500)
    drive.reset(FaultClass.DRIVER)
    drive.run(200)
    drive.start_driving()


@golden(16)
def battery_codes(drive: ScriptedDrive) -> None:
    """Every code of every level of the battery."""
    for signal, most in (
        ("DischargeOvercurrent", 4), ("TemperatureImbalance", 4), ("Overtemperature", 4),
        ("Undertemperature", 4), ("VoltageImbalance", 2), ("InternalFault", 2),
    ):  # fmt: skip
        each_code(drive, f"BMS_Status.{signal}", range(1, most), for_ms=500)


@golden(16)
def controller_codes(drive: ScriptedDrive) -> None:
    """Every code of every protection level of a controller, in turbo."""
    for signal, most in (("TemperatureProtectLevel", 4), ("VoltageLevel", 8)):
        for raw in range(most):
            drive.start_driving(power_mode=PowerMode.TURBO)
            with drive.broken(code(f"PCU{raw % 2 + 1}_Status1.{signal}", raw)):
                drive.run(500)
            drive.run(1200)


@golden(17, 18)
def contradicting_and_flickering(drive: ScriptedDrive) -> None:
    """Too high and too low at once; then undervoltage in every other frame of the battery."""
    drive.start_driving()
    with drive.broken(
        code("BMS_Status.CellOvervoltage", 2), code("BMS_Status.CellUndervoltage", 2)
    ):
        drive.run(800)
    drive.run(1500)
    drive.start_driving()
    for _ in range(4):
        with drive.broken(code("BMS_Status.CellUndervoltage", 1)):
            drive.run(500)
        drive.run(500)


@golden(11, 12)
def life_signal(drive: ScriptedDrive) -> None:
    """The life signal stands still for two frames, for three; then values alone are frozen."""
    drive.start_driving()
    for frames in (1, 2, 3):
        with drive.broken({"fault": "freeze", "signal": "BMS_Status.LifeSignal"}):
            drive.run(500 * frames)
        drive.run(1600)
        drive.start_driving()
    drive.break_with({"fault": "freeze", "signal": "BMS_Status.PackVoltage"})
    drive.run(3000)


@golden(13)
def silent_battery(drive: ScriptedDrive) -> None:
    """The battery is silent to just before and just after its limits, then for good."""
    drive.start_driving(brake_pct=0)
    for silent_ms in (1050, 1090, 1100, 1101, 1150, 1590, 1600, 1601, 1650, 2000):
        battery_until(drive, silent_ms)
        drive.break_with()
        drive.run(1100)
        drive.start_driving()


def battery_until(drive: ScriptedDrive, silent_ms: int) -> None:
    """Tick exactly so long after the battery's last frame."""
    drive.break_with({"fault": "silence", "of": "BMS"})
    drive.ticks(2)
    begin_ns = drive.tick_ns + 50 * MS - silent_ms * MS % (50 * MS)
    drive.wait_until(begin_ns - 60 * MS)
    drive.ticks(1)
    drive.wait_until(begin_ns)
    drive.say("BMS_Status", {"LifeSignal": drive.sequence % 2})
    drive.run(silent_ms + 60)


@golden(19)
def reserved_codes(drive: ScriptedDrive) -> None:
    """All ones and all zeros in each message; codes for error and not available."""
    from tests.core.simulated_drive import CODEC, RECEIVED

    for payload in (bytes(8), b"\xff" * 8):
        for name in RECEIVED:
            drive.start_driving()
            drive.receive(CODEC.by_name[name].spec.can_id, payload)
            drive.run(200)
    drive.start_driving()
    for signal in ("PCU1_Status2.MotorSpeed", "PCU2_Status2.BatteryVoltage"):
        for raw in (0xFFFF, 0xFEFF):
            with drive.broken(code(signal, raw)):
                drive.run(300)


@golden(22)
def speed_steps(drive: ScriptedDrive) -> None:
    """Motor and wheel speeds that change by the limit and by one code more."""
    drive.start_driving(throttle_pct=0)
    for raw in (0, 2000, 4001, 2001, 0, 2001, 2001, 2001, 2001, 0):
        with drive.broken(code("PCU1_Status2.MotorSpeed", raw)):
            drive.run(250)
    drive.run(500)
    for signal, raws in (("WheelSpeedFL", (0, 200, 401, 201, 0, 201)), ("WheelSpeedFR", (0, 255))):
        for raw in raws:
            with drive.broken(code(f"ARD2_SteeringWheel.{signal}", raw)):
                drive.run(200)


@golden(23)
def wheels_differ(drive: ScriptedDrive) -> None:
    """Wheels that differ by the limit and by one code more, for a second and longer."""
    drive.start_driving(throttle_pct=0)
    for left, right in ((150, 0), (151, 0), (0, 151), (150, 0), (152, 1)):
        with drive.broken(
            code("ARD2_SteeringWheel.WheelSpeedFL", left),
            code("ARD2_SteeringWheel.WheelSpeedFR", right),
        ):
            drive.run(950 if left == 152 else 1300)
        drive.run(300)


@golden(29)
def missing_answers(drive: ScriptedDrive) -> None:
    """A controller's answers are 1 to 10 ticks late, or missing; then its Status1."""
    for delay_ms in (50, 100, 150, 180, 200, 250, 500):
        drive.start_driving()
        with drive.broken({"fault": "delay", "of": "PCU2_Status2", "delay_ms": delay_ms}):
            drive.run(600)
        drive.run(1100)
    for of in ("PCU1_Status2", "PCU2_Status1"):
        drive.start_driving(power_mode=PowerMode.TURBO)
        with drive.broken({"fault": "silence", "of": of}):
            drive.run(900)
        drive.run(1100)


@golden(30)
def echoes(drive: ScriptedDrive) -> None:
    """Controllers that echo more, less, or another direction than commanded; one, then both."""
    echo = "PCU1_Status1.Throttle"
    for raw in (0, 62, 64, 80, 92, 120):
        drive.start_driving()
        drive.run(800)
        with drive.broken(code(echo, raw)):
            drive.run(450)
        drive.run(1100)
    drive.start_driving()
    drive.run(800)
    with drive.broken(code(echo, 0), code("PCU2_Status1.Throttle", 0)):
        drive.run(800)
    drive.run(1200)
    for controller in ("PCU1", "PCU2"):
        drive.start_driving()
        with drive.broken(code(f"{controller}_Status1.MotorReverse", 1)):
            drive.run(800)
        drive.run(1500)
    drive.start_driving()
    with drive.broken({"fault": "ignore_commands", "controller": "PCU1", "throttle_pct": 90.0}):
        drive.run(600)
    drive.run(1100)
    drive.until(Mode.FAULT) if drive.gateway.supervisor.mode is Mode.FAULT else None


@golden(30)
def first_echo(drive: ScriptedDrive) -> None:
    """A controller whose first echo comes while it is driven, and says that it does not obey."""
    with drive.broken({"fault": "silence", "of": "PCU1_Status1"}):
        drive.until(Mode.STANDBY)
        drive.run(1200)
        drive.arm()
        drive.ticks(1)
        drive.demand()
        drive.run(1800)
    with drive.broken(code("PCU1_Status1.Throttle", 0)):
        drive.run(1600)
