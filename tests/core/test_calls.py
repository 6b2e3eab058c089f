"""Inputs of the core as values: applying one is the call that it stands for."""

import pytest

from tests.core.simulated_drive import MS, PERIOD_NS, Drive, active, standby
from vcu_gateway.core import calls
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, Demand
from vcu_gateway.core.gateway import CoreCall
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import Carrier, LinkState, LinkStatus
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import FaultClass, Mode
from vcu_gateway.core.transmit import OutFrame


def applied(drive: Drive, one: CoreCall, ticks: int = 1):
    """The answer, and then some ticks in which the vehicle speaks."""
    answer = drive.gateway.apply(one)
    for _ in range(ticks):
        drive.tick()
    return answer


def test_a_frame_is_received():
    drive = Drive()
    frame = Frame(0x1FFF, bytes(8), drive.now_ns, extended=False)
    assert drive.gateway.apply(calls.Receive(frame)) is None
    assert sum(drive.gateway.counters.rejected.values()) == 1


def test_a_lost_link_and_an_opened_one_are_known():
    drive = standby()
    applied(drive, calls.LoseLink(drive.now_ns), ticks=0)
    assert drive.gateway.link.state is LinkState.LOST
    link = LinkStatus(LinkState.UP, drive.now_ns)
    applied(drive, calls.OpenLink(link, None, drive.now_ns), ticks=0)
    assert drive.gateway.link == link


def test_a_carrier_that_goes_is_a_bus_off():
    drive = standby()
    applied(drive, calls.ChangeCarrier(Carrier(False, drive.now_ns)), ticks=0)
    assert drive.gateway.link.state is LinkState.BUS_OFF


def test_too_many_restarts_are_against_arming():
    drive = standby()
    applied(drive, calls.CountRestarts(3))
    assert "restarted 3 times" in drive.gateway.apply(calls.Arm(drive.now_ns)).sentence


def test_a_restart_state_that_cannot_be_kept_is_against_arming():
    drive = standby()
    applied(drive, calls.NoteRestartState("No space"))
    assert "No space" in drive.gateway.apply(calls.Arm(drive.now_ns)).sentence
    applied(drive, calls.NoteRestartState(None))
    assert drive.gateway.apply(calls.Arm(drive.now_ns)).granted


def test_a_cut_of_the_process_before_is_latched_again():
    drive = Drive()
    applied(drive, calls.BeginFrom("undervoltage", {"PCU1": True}))
    assert drive.gateway.supervisor.latch.reason == "undervoltage"


def test_a_demand_counts_until_its_source_ends_it():
    drive = active()
    both = dict.fromkeys(CONTROLLERS, ControllerDemand())
    demand = Demand("another", 1, 200, both)
    assert not drive.gateway.apply(calls.Offer(demand, drive.now_ns)).granted
    assert drive.gateway.apply(calls.EndDemand("driver", drive.now_ns)).granted
    assert drive.mode is Mode.STANDBY


def test_arming_and_disarming_are_requests():
    drive = standby()
    assert drive.gateway.apply(calls.Arm(drive.now_ns)).granted
    assert drive.mode is Mode.ACTIVE
    assert drive.gateway.apply(calls.Disarm(drive.now_ns)).granted
    assert drive.mode is Mode.STANDBY


def test_an_emergency_stop_cuts_until_it_is_reset():
    drive = active()
    assert applied(drive, calls.EmergencyStop()).granted
    assert drive.mode is Mode.FAULT
    drive.run(1500)
    assert drive.gateway.apply(calls.Reset(FaultClass.SERVICE, drive.now_ns)).granted


def test_terminating_ends_in_stopping():
    drive = active()
    applied(drive, calls.Terminate())
    assert drive.mode is Mode.STOPPING


@pytest.mark.parametrize(("period_ns", "granted"), [(PERIOD_NS, True), (PERIOD_NS + 1, False)])
def test_new_settings_are_taken_or_refused(period_ns, granted):
    drive = standby()
    settings = Settings(derated_power_w=5_000, period_ns=period_ns)
    assert drive.gateway.apply(calls.ReloadSettings(settings)).granted is granted
    assert (drive.gateway.settings == settings) is granted


def test_a_tick_gives_frames_and_sending_them_is_noted():
    drive = standby()
    now_ns = drive.now_ns + 50 * MS
    result = drive.gateway.apply(calls.RunTick(now_ns))
    frame = result.frames[0]
    assert isinstance(frame, OutFrame)
    history = drive.gateway.transmitter.history.frames["PCU1"]
    assert history[-1].at_ns < now_ns
    drive.gateway.apply(calls.NoteSent(frame, True, now_ns))
    assert history[-1].at_ns == now_ns
