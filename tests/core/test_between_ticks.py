"""Nothing that arrives between two ticks is lost: whatever followed it, in whatever order."""

from itertools import permutations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.core.simulated_drive import (
    CODEC,
    MS,
    PERIOD_NS,
    PROTOCOL,
    ZERO_TORQUE,
    Drive,
    active,
    data,
    in_mode,
    standby,
)
from vcu_gateway.core import calls
from vcu_gateway.core.causes import Effect
from vcu_gateway.core.codec import Decoded
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, Demand
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.state import Store
from vcu_gateway.core.supervisor import FaultClass, Mode

STATUS = "BMS_Status"
CODED = (
    *(f"{STATUS}.{name}" for name in ("CellOvervoltage", "CellUndervoltage", "Overtemperature")),
    *(f"{STATUS}.{name}" for name in ("DischargeOvercurrent", "Undertemperature", "SOC")),
    f"{STATUS}.InternalFault",
    *(f"{name}_Status1.{level}" for name in CONTROLLERS
      for level in ("TemperatureProtectLevel", "VoltageLevel")),
    "PCU1_Status2.MotorSpeed",
)  # fmt: skip
WIDEST = {"SOC": 255, "MotorSpeed": 6050}


def codes_of(name: str) -> range:
    message, signal = name.split(".")
    length_bits = PROTOCOL.message(message).signal(signal).length_bits
    return range(WIDEST.get(signal, (1 << length_bits) - 1) + 1)


ONE_CODE = st.sampled_from(CODED).flatmap(
    lambda name: st.tuples(st.just(name), st.sampled_from(codes_of(name)))
)
DRIVING = active()
DRIVING.tick(MS)  # whatever follows is within one period


def effects_after(*codes: tuple[str, int]) -> frozenset[Effect]:
    """What counts after a tick in which these frames came, one after the other."""
    drive = DRIVING.twin()
    for number, (name, raw) in enumerate(codes):
        drive.codes = {name: raw}
        drive.receive(name.split(".")[0], drive.now_ns + number + 1)
    drive.codes.clear()
    drive.now_ns += PERIOD_NS // 2
    drive.gateway.tick(drive.now_ns)
    return drive.gateway.causes.effects()


@given(st.lists(ONE_CODE, min_size=1, max_size=6))
def test_a_tick_does_what_the_worst_of_its_frames_alone_would_do(codes):
    together = effects_after(*codes)
    alone = frozenset().union(*(effects_after(one) for one in codes))
    # A change from frame to frame may raise an alarm of its own.
    assert together - {Effect.ALARM} == alone - {Effect.ALARM}
    assert together >= alone


@pytest.mark.parametrize("good_after", [0, 1, 3])
@pytest.mark.parametrize(
    ("name", "raw", "mode"),
    [
        (f"{STATUS}.InternalFault", 1, Mode.FAULT),
        (f"{STATUS}.CellUndervoltage", 2, Mode.FAULT),
        ("PCU2_Status1.TemperatureProtectLevel", 2, Mode.FAULT),
        (f"{STATUS}.CellUndervoltage", 1, Mode.ACTIVE),
    ],
)
def test_a_bad_frame_counts_though_good_ones_follow_it(name, raw, mode, good_after):
    drive = active()
    drive.codes[name] = raw
    drive.receive(name.split(".")[0])
    drive.codes.clear()
    for _ in range(good_after):
        drive.receive(name.split(".")[0])
    drive.tick()
    assert drive.mode is mode
    assert name in {held.finding.subject for held in drive.gateway.causes.held}


def test_the_last_level_counts_on_when_no_frame_comes():
    drive = active()
    drive.codes[f"{STATUS}.CellUndervoltage"] = 1
    drive.receive(STATUS)
    drive.silent.add(STATUS)
    for _ in range(5):
        drive.tick()
        assert Effect.POWER_LIMIT in drive.gateway.causes.effects()
        assert drive.gateway.causes.held[0].stands(drive.now_ns)


def test_a_life_signal_that_stood_still_in_every_other_frame_counts():
    drive = active()
    for life in (1, 1, 0):
        drive.codes[f"{STATUS}.LifeSignal"] = life
        drive.receive(STATUS)
    drive.tick()
    found = [held.finding for held in drive.gateway.causes.held]
    assert {one.effect for one in found} == {Effect.POWER_LIMIT, Effect.REGEN_LIMIT}
    assert found[0].detail == "unchanged in 2 frames"


def test_every_value_out_of_range_is_told_though_a_good_one_followed():
    drive = active()
    for soc, voltage in ((101, 5000), (80, 10_001), (80, 5000)):
        drive.codes = {f"{STATUS}.SOC": soc, f"{STATUS}.PackVoltage": voltage}
        drive.receive(STATUS)
    drive.tick()
    found = {held.finding.subject: held.finding.detail for held in drive.gateway.causes.held}
    assert found == {f"{STATUS}.SOC": "raw 101", f"{STATUS}.PackVoltage": "raw 10001"}


@pytest.mark.parametrize("rpm", [50, 6001])
@pytest.mark.parametrize("order", list(permutations(range(3))))
def test_a_direction_changes_only_where_every_speed_of_the_tick_allows_it(rpm, order):
    drive = standby()
    drive.silent.add("PCU1_Status2")
    drive.demanded = ControllerDemand(motor_reverse=True)
    speeds = (0, rpm, 0)
    for number, index in enumerate(order):
        frame = data("PCU1_Status2", {"MotorSpeed": speeds[index]})
        can_id = CODEC.by_name["PCU1_Status2"].spec.can_id
        drive.gateway.receive(Frame(can_id, frame, drive.now_ns + number))
    drive.tick()
    assert drive.commands == [ZERO_TORQUE] * 2


def test_a_frame_that_came_out_of_order_is_judged_and_replaces_nothing():
    drive = active()
    drive.receive(STATUS, drive.now_ns + 2)
    drive.codes[f"{STATUS}.InternalFault"] = 1
    drive.receive(STATUS, drive.now_ns + 1)
    drive.codes.clear()
    drive.tick()
    assert drive.mode is Mode.FAULT
    reading = drive.result.snapshot.reading(STATUS, "InternalFault")
    assert reading.raw == 0


# The book of arrivals.


def store_and_frame() -> tuple[Store, Decoded]:
    received = PROTOCOL.received_by("VCU")
    store = Store(received, {message.name: 10**9 for message in received})
    return store, CODEC.by_name[STATUS].decode(data(STATUS))


def test_what_was_taken_is_not_taken_again_and_looking_takes_nothing():
    store, frame = store_and_frame()
    store.put(STATUS, frame, 1)
    store.put(STATUS, frame, 2)
    assert store.snapshot(3).arrived(STATUS) == ()
    assert [one.arrival_ns for one in store.take(3).arrived(STATUS)] == [1, 2]
    assert store.take(4).arrived(STATUS) == ()


def test_a_snapshot_does_not_change_when_frames_arrive_after_it_was_taken():
    store, frame = store_and_frame()
    store.put(STATUS, frame, 1)
    taken = store.take(2)
    store.put(STATUS, frame, 3)
    assert [one.arrival_ns for one in taken.arrived(STATUS)] == [1]


def test_more_frames_than_a_tick_can_judge_are_counted():
    store, frame = store_and_frame()
    for at_ns in range(4098):
        store.put(STATUS, frame, at_ns)
    assert len(store.take(5000).arrived(STATUS)) == 4096
    assert store.unjudged == 2


# A tick that comes too late.

LATE_NS = 5 * PERIOD_NS
BOTH = dict.fromkeys(CONTROLLERS, ControllerDemand())
REQUESTS = {
    "a demand": lambda drive: drive.offer(ControllerDemand()),
    "an expired demand": lambda drive: drive.offer(ControllerDemand(), made_ns=drive.now_ns - 1),
    "a demand ends": lambda drive: drive.gateway.requests.end_demand("driver", drive.now_ns),
    "disarm": lambda drive: drive.gateway.requests.disarm(drive.now_ns),
    "arm": lambda drive: drive.arm(),
    "nothing": lambda drive: None,
}


@pytest.mark.parametrize("request_of", REQUESTS)
@pytest.mark.parametrize(("beyond_ns", "mode"), [(1, Mode.FAULT), (300 * MS, Mode.FAULT)])
def test_a_late_tick_latches_whatever_was_asked_meanwhile(request_of, beyond_ns, mode):
    drive = active()
    drive.ttl_ms = 200
    drive.demanded = None
    drive.now_ns += LATE_NS + beyond_ns
    REQUESTS[request_of](drive)
    drive.gateway.tick(drive.now_ns)
    assert drive.mode is mode
    assert drive.gateway.supervisor.latch.reason.startswith("tick ")


@pytest.mark.parametrize("request_of", ["disarm", "a demand ends"])
def test_a_tick_that_is_late_by_4_periods_ends_the_drive_as_asked(request_of):
    drive = active()
    drive.now_ns += LATE_NS
    REQUESTS[request_of](drive)
    assert drive.mode is Mode.STANDBY


@pytest.mark.parametrize("request_of", ["disarm", "a demand ends"])
@pytest.mark.parametrize(("late_ns", "latches"), [(LATE_NS, False), (LATE_NS + 1, True)])
def test_a_request_in_time_does_not_excuse_the_late_tick_of_a_drive(request_of, late_ns, latches):
    drive = active()
    drive.now_ns += LATE_NS - MS
    REQUESTS[request_of](drive)
    assert drive.mode is Mode.STANDBY
    drive.gateway.tick(drive.now_ns + late_ns - LATE_NS + MS)
    assert (drive.mode is Mode.FAULT) is latches


def test_a_late_tick_in_standby_latches_nothing():
    drive = active()
    REQUESTS["disarm"](drive)
    drive.tick()
    drive.gateway.tick(drive.now_ns + LATE_NS + 1)
    assert drive.gateway.supervisor.latch is None


def test_a_late_tick_in_standby_is_a_cause_to_stop():
    drive = standby()
    drive.gateway.tick(drive.now_ns + LATE_NS + 1)
    assert "tick 200 ms: stop" in drive.sentence


def test_a_late_tick_after_arming_latches_before_an_end_that_was_asked_for():
    drive = standby()
    assert drive.arm().granted
    drive.gateway.requests.terminate()
    drive.gateway.tick(drive.now_ns + LATE_NS + 1)
    assert drive.mode is Mode.STOPPING
    assert drive.gateway.supervisor.latch.reason.startswith("tick ")


@pytest.mark.parametrize("request_of", ["disarm", "a demand", "a demand ends"])
def test_a_late_tick_cannot_be_reset_before_it_was_ticked(request_of):
    drive = active()
    drive.now_ns += LATE_NS + 1
    REQUESTS[request_of](drive)
    assert drive.mode is Mode.FAULT
    assert drive.reset().sentence == "tick 200 ms: stop stands or stood a moment ago"
    drive.demanded = ControllerDemand()
    drive.tick()
    drive.run(950)
    assert not drive.reset(FaultClass.DRIVER).granted
    drive.run(100)
    assert drive.reset(FaultClass.DRIVER).granted


# A reset goes through STARTING.


def stopped_in_starting(**settings: int) -> Drive:
    drive = Drive(**settings)
    drive.run(1200)
    assert drive.mode is Mode.STARTING
    drive.gateway.requests.emergency_stop()
    drive.tick()
    assert drive.mode is Mode.FAULT
    return drive


def test_an_emergency_stop_in_starting_and_a_reset_do_not_go_round_the_qualification():
    drive = Drive()
    drive.codes[f"{STATUS}.SOC"] = 101  # not one good frame
    drive.run(1200)
    drive.gateway.requests.emergency_stop()
    drive.run(3000)
    assert drive.reset().granted
    drive.run(3000)
    assert drive.mode is Mode.STARTING
    assert not drive.arm().granted
    drive.codes.clear()
    drive.until(Mode.STANDBY)


def test_a_reset_does_not_begin_the_qualification_anew():
    drive = stopped_in_starting()
    drive.run(3000)
    assert drive.reset().granted
    assert drive.mode is Mode.STARTING
    drive.tick()
    assert drive.mode is Mode.STANDBY, "in the same tick"


@pytest.mark.parametrize("how", ["a message", "the link"])
def test_what_is_lost_in_a_fault_has_to_qualify_again_after_the_reset(how):
    drive = in_mode(Mode.FAULT, qualify_frames=5)
    if how == "a message":
        drive.silent.add("PCU1_Status2")
        drive.run(500)
        drive.silent.clear()
    else:
        drive.gateway.apply(calls.LoseLink(drive.now_ns))
        drive.run(100)
        drive.open_link()
    drive.run(1100)
    assert drive.reset(FaultClass.DRIVER).granted
    drive.tick()
    assert drive.mode is Mode.STARTING
    drive.until(Mode.STANDBY, within_ms=2500)


def test_a_link_lost_for_a_moment_in_standby_begins_the_qualification_anew():
    drive = standby()
    drive.gateway.apply(calls.LoseLink(drive.now_ns))
    drive.open_link()
    drive.tick()
    assert drive.mode is Mode.STARTING
    assert not drive.arm().granted
    drive.until(Mode.STANDBY)


def test_arming_is_refused_until_the_tick_after_a_reset():
    drive = in_mode(Mode.FAULT)
    assert drive.reset(FaultClass.DRIVER).granted
    assert not drive.arm().granted
    drive.run(100)
    assert drive.gateway.requests.offer(Demand("driver", 10**9, 200, BOTH), drive.now_ns).granted
    assert drive.mode is Mode.STANDBY


@pytest.mark.parametrize("order", list(permutations(range(3))))
@pytest.mark.parametrize(("slow_rpm", "regenerates"), [(99, False), (100, True)])
def test_regeneration_ends_where_one_speed_of_the_tick_is_too_low(order, slow_rpm, regenerates):
    drive = active(throttle_slew_pct_per_s=200.0)
    drive.codes = {f"{name}_Status2.MotorSpeed": 1000 for name in CONTROLLERS}
    drive.demanded = ControllerDemand(brake_pct=40, regen_brake=True)
    drive.run(1000)
    assert drive.commands[0][0] & 0x20
    for number, index in enumerate(order):
        frame = data("PCU1_Status2", {"MotorSpeed": (1000, slow_rpm, 1000)[index]})
        can_id = CODEC.by_name["PCU1_Status2"].spec.can_id
        drive.gateway.receive(Frame(can_id, frame, drive.now_ns + number))
    drive.tick()
    assert (drive.commands[0][0] & 0x20 > 0) is regenerates


def test_senders_of_any_identifier_are_one_cause():
    """Its memory is bounded, however many source addresses somebody tries."""
    drive = standby()
    for source in range(30):
        drive.gateway.receive(Frame(0x0008A700 + source, ZERO_TORQUE, drive.now_ns))
        drive.tick()
    (found,) = [held.finding for held in drive.gateway.causes.held if held.finding.latches]
    assert str(found) == "command 0008A71D: stop"
    assert drive.gateway.supervisor.latch.reason == "command 0008A700: stop"
