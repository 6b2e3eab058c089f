"""A recorded drive of some seconds with a fault in it, in simulated time."""

from pathlib import Path

from tests.recording.recorded import RecordedDrive
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.supervisor import Mode

FAULT_S = 6
DRIVE_S = 12


def record(folder: Path, seconds: int = DRIVE_S, segment_s: int = 5) -> RecordedDrive:
    """Drive with throttle; undervoltage in second 6 latches a fault."""
    drive = RecordedDrive(folder, segment_s * 10**9)
    drive.open_link()
    drive.until(Mode.STANDBY).run(1500)
    assert drive.arm().granted
    for number in range(seconds * 20):
        drive.demanded = ControllerDemand(throttle_pct=20 + number % 40)
        drive.codes["BMS_Status.CellUndervoltage"] = 2 if number >= FAULT_S * 20 else 0
        drive.tick()
    drive.close()
    return drive
