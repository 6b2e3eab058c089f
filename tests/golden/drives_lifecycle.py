"""Golden drives of the beginning and the end of a gateway, and of long and random ones."""

from random import Random

from tests.golden.drives_vehicle import code
from tests.golden.scripted_drive import END_TICKS_AT_MOST, MS, ScriptedDrive, Step
from tests.golden.scripts import golden
from vcu_gateway.core import calls
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.supervisor import FaultClass

DAYS_200_NS = 200 * 86_400_000 * MS


@golden(52, 84)
def ended_in_order(drive: ScriptedDrive) -> None:
    """Terminated while driving; the bus takes no frames just before, and of two ticks after."""
    drive.start_driving()
    drive.accepted = False
    drive.ticks(1)
    drive.end(1, 3)


@golden(52)
def ended_without_a_bus(drive: ScriptedDrive) -> None:
    """Terminated while driving, and no safe frame leaves: it gives up."""
    drive.start_driving()
    drive.end(*range(1, END_TICKS_AT_MOST))


@golden(52)
def ended_while_listening(drive: ScriptedDrive) -> None:
    """Terminated before it sent anything: no frame is owed."""
    drive.run(300)
    drive.end()


@golden(49, 51, 67, 84)
def restarted_while_rolling(drive: ScriptedDrive) -> None:
    """A start after a crash in reverse with a latched CUT, with motors that turn."""
    drive.gateway.apply(calls.CountRestarts(1))
    drive.gateway.apply(
        calls.BeginFrom("BMS_Status.InternalFault 1: cut", {"PCU1": True, "PCU2": True})
    )
    with drive.broken(code("PCU1_Status2.MotorSpeed", 1500)):
        drive.run(2500)
        drive.reset(FaultClass.DRIVER)
        drive.reset()
        drive.run(1500)
    drive.start_driving()


@golden(49, 51)
def restarted_in_reverse(drive: ScriptedDrive) -> None:
    """A start after a crash in reverse, of which only one controller says anything."""
    drive.gateway.apply(calls.BeginFrom(None, {"PCU1": True, "PCU2": True}))
    silent: Step = {"fault": "silence", "of": "PCU2_Status1"}
    with drive.broken(code("PCU1_Status1.MotorReverse", 1), silent):
        drive.run(1500)


@golden(49, 51)
def restarted_too_often(drive: ScriptedDrive) -> None:
    """The third unexpected start of a drive: nothing can be armed."""
    drive.gateway.apply(calls.CountRestarts(3))
    drive.gateway.apply(calls.BeginFrom(None, {"PCU1": True, "PCU2": False}))
    drive.run(3000)
    drive.arm()
    drive.run(300)
    drive.gateway.apply(calls.CountRestarts(2))
    drive.arm()
    drive.run(500)


@golden()
def restart_state(drive: ScriptedDrive) -> None:
    """A restart state that cannot be kept, before arming and in the drive."""
    drive.gateway.apply(calls.NoteRestartState("No space left on device"))
    drive.run(3000)
    drive.arm()
    drive.run(300)
    drive.gateway.apply(calls.NoteRestartState(None))
    drive.start_driving()
    drive.gateway.apply(calls.NoteRestartState("Read-only file system"))
    drive.run(500)
    drive.gateway.apply(calls.NoteRestartState(None))
    drive.run(1500)


@golden(81, start_ns=DAYS_200_NS)
def after_200_days(drive: ScriptedDrive) -> None:
    """A drive on a machine that has been up for 200 days."""
    drive.start_driving()
    drive.run(700)
    drive.break_with({"fault": "silence", "of": "PCU1"})
    drive.run(1000)


@golden(config="bench: {auto_arm: true, demand: {bench_use_only: true, throttle_pct: 15,"
        " power_mode: normal}}")  # fmt: skip
def bench(drive: ScriptedDrive) -> None:
    """A test bench that arms once by itself, is disarmed, and is taken over by a driver."""
    drive.demanded = None
    drive.run(4000)
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.run(1500)
    drive.arm()
    drive.run(500)
    drive.demanded = ControllerDemand()
    drive.run(600)


@golden(53)
def reader_gone(drive: ScriptedDrive) -> None:
    """Nothing is received any more: everything becomes stale, and nothing is confirmed."""
    drive.start_driving()
    drive.connected = False
    drive.run(3000)
    drive.connected = True
    drive.run(2500)


@golden(58, 79, 80, quiet=False)
def random_walk(drive: ScriptedDrive) -> None:
    """Anything in any order: faults, requests, frames, late ticks, a link that goes."""
    chance = Random(80)
    for _ in range(12):
        drive.start_driving(throttle_pct=chance.choice((5.0, 30.0, 100.0)))
        _anything(drive, chance)
        drive.accepted = drive.echo = drive.connected = True
        drive.break_with()
        drive.run(chance.randrange(200, 1200))


def _anything(drive: ScriptedDrive, chance: Random) -> None:
    what = chance.randrange(8)
    if what == 0:
        drive.break_with({"fault": "drop", "share_pct": chance.choice((20, 60))})
    elif what == 1:
        drive.break_with(code("BMS_Status.DischargeOvercurrent", chance.randrange(1, 4)))
    elif what == 2:
        drive.lose_link()
        drive.run(chance.randrange(20, 600))
        drive.open_link()
    elif what == 3:
        drive.accepted = False
    elif what == 4:
        drive.tick(chance.randrange(1, 400) * MS)
    elif what == 5:
        drive.gateway.apply(calls.EmergencyStop())
    elif what == 6:
        drive.demanded = None
    else:
        drive.break_with({"fault": "corrupt", "of": "PCU1", "flip_bits": 2})
    drive.run(chance.randrange(100, 900))
