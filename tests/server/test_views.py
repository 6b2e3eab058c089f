"""Commands and stop as the API tells them: decided, sent and come back apart."""

import pytest

from tests.core.simulated_drive import Drive, active, standby
from vcu_gateway.api import openrpc, results
from vcu_gateway.core import calls
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.supervisor import FaultClass
from vcu_gateway.core.tuning import DriveMode, Tuning
from vcu_gateway.daemon.loop import LastTick
from vcu_gateway.server import views

MS = 1_000_000
Frames = dict[results.ControllerName, str]
ZERO_TORQUE: Frames = {"PCU1": "0008A7D0#0C000000E02E0000", "PCU2": "0008A8D0#0C000000E02E0000"}
POWER_CUT: Frames = {"PCU1": "0008A7D0#8C000000E02E0000", "PCU2": "0008A8D0#8C000000E02E0000"}


def told(drive: Drive, after_ms: int = 0) -> results.State:
    """The state, some time after the last tick; held against its type."""
    assert drive.result is not None
    latest = LastTick.explained(drive.gateway, drive.result, drive.now_ns)
    state = views.state(drive.gateway, latest, drive.now_ns + after_ms * MS)
    openrpc.result_adapter(results.State).validate_python(state)
    return state


def stopped(drive: Drive) -> Drive:
    drive.gateway.requests.emergency_stop()
    drive.tick()
    return drive


def test_a_frame_that_left_is_told_as_decided_sent_and_come_back_with_its_age():
    state = told(standby(), after_ms=7)
    for name, frame in ZERO_TORQUE.items():
        command = state["commands"][name]
        assert command["decided"] == frame
        assert command["sent"] == command["echoed"] == {"frame": frame, "age_ms": 7.0}


def test_while_listening_nothing_is_decided_sent_or_come_back():
    drive = Drive()
    drive.tick()
    command = told(drive)["commands"]["PCU1"]
    assert (command["decided"], command["sent"], command["echoed"]) == (None, None, None)


def test_what_the_kernel_refuses_is_decided_and_not_sent():
    drive = standby()
    drive.accepted = False
    state = told(stopped(drive), after_ms=1)
    for name, frame in POWER_CUT.items():
        command = state["commands"][name]
        assert command["decided"] == frame
        assert command["sent"] == command["echoed"] == {"frame": ZERO_TORQUE[name], "age_ms": 51.0}
    assert state["stop"]["stage"] == "latched"
    assert state["stop"]["sentence"] == "Stop latched; not sent to PCU1 and PCU2"


def test_what_does_not_come_back_is_sent_and_not_come_back():
    drive = standby()
    drive.echo = False
    command = told(stopped(drive))["commands"]["PCU2"]
    assert command["sent"] == {"frame": POWER_CUT["PCU2"], "age_ms": 0.0}
    assert command["echoed"] == {"frame": ZERO_TORQUE["PCU2"], "age_ms": 50.0}
    assert told(drive)["stop"]["stage"] == "sent"


def test_an_age_is_never_below_0_where_a_frame_came_after_the_question():
    drive = standby()
    echo = Frame(0x0008A7D0, bytes(8), drive.now_ns + MS, own_echo=True)
    drive.gateway.receive(echo)
    assert told(drive)["commands"]["PCU1"]["echoed"]["age_ms"] == 0.0


def test_without_a_latched_cut_there_is_no_stop():
    drive = standby()
    assert told(drive)["stop"] is None
    drive.receive_foreign()
    drive.tick()
    state = told(drive)
    assert (state["mode"], state["stop"]) == ("fault", None)


def test_a_stop_has_the_age_of_everything_that_is_known_of_it():
    drive = standby()
    drive.codes["PCU1_Status1.PowerCut"] = drive.codes["PCU2_Status1.PowerCut"] = 1
    stopped(drive).run(1000)
    state = told(drive, after_ms=10)
    one = {
        "sent_ms": 1010.0,
        "echoed_ms": 1010.0,
        "obeyed": True,
        "judged_ms": state["messages"]["PCU1_Status1"]["age_ms"],
        "power_cut": "cut",
        "throttle_pct": 0.0,
        "missing": "",
    }
    assert state["stop"] == {
        "latched_ms": 1010.0,
        "reason": "emergency stop requested: cut",
        "stage": "cut",
        "sentence": "Power is cut: PCU1 and PCU2 confirm",
        "controllers": {"PCU1": one, "PCU2": one},
    }


def test_a_reset_ends_the_stop_in_the_answer_that_follows_it():
    drive = stopped(standby())
    drive.run(1500)
    assert told(drive)["stop"] is not None
    assert drive.reset().granted
    assert told(drive)["stop"] is None
    drive.tick()
    assert told(drive)["stop"] is None


TUNING = Tuning(start="eco", modes={"eco": DriveMode(), "sport": DriveMode()})


@pytest.mark.parametrize(
    ("begin", "throttle_pct", "mode", "waits"),
    [
        (active, 60.0, "sport", True),
        (active, 5.0, "sport", True),
        (active, 4.9, "sport", False),
        (active, None, "sport", False),
        (active, 60.0, "eco", False),
        (standby, 60.0, "sport", False),
    ],
)
def test_whether_a_drive_mode_waits_is_told_before_the_tick_that_shows_it(
    begin, throttle_pct, mode, waits
):
    drive = begin(tuning=TUNING)
    drive.demanded = throttle_pct and ControllerDemand(throttle_pct=throttle_pct)
    drive.run(250)
    assert drive.gateway.apply(calls.SetDriveMode(mode, FaultClass.DRIVER, drive.now_ns)).granted
    assert views.waits_for_release(drive.gateway, drive.now_ns) is waits
    drive.tick()
    current, requested = drive.gateway.drive_modes
    assert (current != requested, requested) == (waits, mode)
