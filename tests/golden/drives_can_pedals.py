"""Golden drives with a pedal node on CAN: that of config/examples/pedals.yaml."""

from tests.golden.drives_vehicle import code
from tests.golden.scripted_drive import ScriptedDrive, Step
from tests.golden.scripts import ROOT, golden
from vcu_gateway.core.supervisor import Mode

EXAMPLES = ROOT / "config" / "examples"
PEDALS = """
pedals:
  can:
    message: Pedals_Position
    throttle: {signal: Throttle1, released: 0.62, pressed: 3.85}
    throttle_track2: {signal: Throttle2, released: 0.31, pressed: 1.92}
    brake: {signal: BrakePressure, released: 0.5, pressed: 60}
    counter: Counter
    checksum: {signal: Checksum, kind: sae_j1850}
    reverse: ReverseSwitch
    power_mode: turbo
    regen_brake: true
"""
COASTING = PEDALS + "    coast_brake_pct: [[0, 20], [5, 0]]\n"
SILENT: Step = {"fault": "silence", "of": "PEDALS"}
FROZEN: Step = {"fault": "freeze", "signal": "Pedals_Position.Counter"}
STUCK: Step = {"fault": "freeze", "signal": "Pedals_Position.Throttle1"}
TWICE: Step = {"fault": "duplicate", "of": "PEDALS"}
LATE: Step = {"fault": "delay", "of": "PEDALS", "delay_ms": 45}
SWAPPED: Step = {
    "fault": "swap",
    "signal": "Pedals_Position.Throttle1",
    "with_signal": "Pedals_Position.Throttle2",
}


def pedal_code(signal: str, raw: int) -> Step:
    return code(f"Pedals_Position.{signal}", raw)


def press(drive: ScriptedDrive, travel_pct: float, brake_pct: float = 0.0, ms: int = 700) -> None:
    drive.throttle.pct, drive.brake.pct = travel_pct, brake_pct
    drive.run(ms)


def drive_off(drive: ScriptedDrive, travel_pct: float = 43.0) -> None:
    """With the foot off until it is armed, then pressed."""
    drive.demanded = None
    press(drive, 0, ms=1200)
    for _ in range(40):
        if drive.gateway.supervisor.mode is Mode.ACTIVE:
            break
        if not drive.gateway.requests.against_arming(drive.now_ns):
            drive.arm()
        drive.tick()
    press(drive, travel_pct)


@golden(92, 93, config=PEDALS, dbc=EXAMPLES / "pedals.dbc")
def can_pedals(drive: ScriptedDrive) -> None:
    """A foot drives, brakes, turns round, and presses too early and after a silence."""
    drive.demanded = None
    press(drive, 20, ms=2500)
    drive.arm()  # refused: the pedal is pressed
    drive_off(drive)
    for travel_pct in (2.9, 3.1, 96.9, 97.1, 109.9, -9.9):
        press(drive, travel_pct, ms=300)
    press(drive, 0, 60, ms=4000)
    with drive.broken(pedal_code("ReverseSwitch", 1)):
        press(drive, 0, 60, ms=1000)
        press(drive, 30)
        press(drive, 0, 60, ms=3000)
    press(drive, 60, 20)  # brake over throttle
    with drive.broken(SILENT):
        press(drive, 60, ms=500)
    press(drive, 60)
    drive.arm()  # refused again
    drive_off(drive)


@golden(85, 86, 87, config=PEDALS, dbc=EXAMPLES / "pedals.dbc")
def can_pedals_not_believed(drive: ScriptedDrive) -> None:
    """Wires open, tracks that differ, codes that are none: for up to 100 ms, and for longer."""
    drive_off(drive)
    for wrong in (
        pedal_code("Throttle1", 0),
        pedal_code("Throttle2", 4095),
        pedal_code("BrakePressure", 1023),
        pedal_code("ReverseSwitch", 2),
    ):
        with drive.broken(wrong):
            press(drive, 43, ms=70)
        press(drive, 43)
        with drive.broken(wrong):
            press(drive, 43, ms=300)
        press(drive, 43)
        press(drive, 0, ms=700)
        press(drive, 20, ms=300)
        press(drive, 0, ms=1300)
        press(drive, 43)
    for wrong in (SWAPPED, STUCK):
        with drive.broken(wrong):
            press(drive, 43, ms=70)
            press(drive, 0, ms=500)
        press(drive, 0, ms=1300)
        press(drive, 43)


@golden(85, config=PEDALS, dbc=EXAMPLES / "pedals.dbc")
def can_pedals_released_again(drive: ScriptedDrive) -> None:
    """After an open wire: not released at 5.3 % of the throttle, released at 4.7 %."""
    drive_off(drive)
    with drive.broken(pedal_code("Throttle1", 0)):
        press(drive, 43, ms=300)
    for travel_pct in (8.0, 7.4):  # with a dead zone of 3 %
        press(drive, travel_pct, ms=1500)
        press(drive, 43, ms=300)


@golden(88, 89, 90, 91, config=COASTING, dbc=EXAMPLES / "pedals.dbc")
def can_pedals_no_demands(drive: ScriptedDrive) -> None:
    """Frames that are no demands: counter, checksum, twice, late; and a coasting vehicle."""
    drive_off(drive)
    press(drive, 0, ms=1000)
    press(drive, 4, ms=500)
    with drive.broken(TWICE):
        press(drive, 43, ms=400)
    press(drive, 43)
    with drive.broken(LATE):
        press(drive, 43)
    for wrong in (FROZEN, pedal_code("Checksum", 1), SILENT):
        drive_off(drive)
        with drive.broken(wrong):
            press(drive, 43, ms=45)
        press(drive, 43)
        with drive.broken(wrong):
            press(drive, 43, ms=400)
