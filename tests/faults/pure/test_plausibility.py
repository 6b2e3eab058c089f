"""Frames that are each in order and cannot be true together, in simulated time: faults 22 to 30."""

import dataclasses

import pytest

from tests.core.simulated_drive import CODEC, MS, ZERO_TORQUE, Drive, active
from tests.faults.conftest import Seen
from vcu_gateway.core.demand import ControllerDemand, PowerMode, Refusal
from vcu_gateway.core.supervisor import Mode

THROTTLE = ControllerDemand(throttle_pct=40, power_mode=PowerMode.TURBO)
COMMAND = CODEC.by_name["VCU_PCU1_Command"]
WHEELS = "ARD2_SteeringWheel"
LEFT, RIGHT = f"{WHEELS}.WheelSpeedFL", f"{WHEELS}.WheelSpeedFR"
IMU = {"IMU_Acceleration", "IMU_AngularRate", "IMU_Attitude"}  # nothing here depends on it
CONTROLLERS = pytest.mark.parametrize("controller", ["PCU1", "PCU2"])


def driving(asked: ControllerDemand = THROTTLE, **settings) -> Drive:
    """A drive in ACTIVE that has had two seconds to reach what is asked, with nothing held."""
    drive = active(**settings)
    drive.silent |= IMU
    drive.demanded = asked
    drive.run(2000)
    assert (drive.mode, found(drive)) == (Mode.ACTIVE, set())
    return drive


def found(drive: Drive) -> set[tuple[str, str, str]]:
    """Cause, subject and effect of each that counts, but for the silent inertial unit."""
    why = drive.gateway.why(drive.now_ns)
    held = [one.finding for one in (*why.blocks, *why.limits, *why.alarms)]
    return {(f.cause, f.subject, f.effect.value) for f in held if f.subject not in IMU}


def commanded(drive: Drive, signal: str) -> list[float]:
    """A signal of both controllers' last commands."""
    index = COMMAND.spec.signal_names.index(signal)
    return [COMMAND.decode(frame).values[index] for frame in drive.commands]


def next_frame(drive: Drive, message: str) -> int:
    """Tick until a frame of this message came in; when it came."""
    for _ in range(20):
        if frames := drive.tick().snapshot.arrived(message):
            return frames[-1].arrival_ns
    raise AssertionError(f"no {message} within a second")


# 22: a value jumps.


@CONTROLLERS
def test_f22_a_motor_speed_that_jumps_is_told_and_not_believed_until_three_plausible_ones(
    controller, seen: Seen
):
    signal = f"{controller}_Status2.MotorSpeed"
    drive = driving()
    for speed_rpm in (2000, 4000, 2000, 0):
        drive.codes[signal] = speed_rpm
        drive.run(50)
        assert found(drive) == set(), f"2000 rpm in 50 ms to {speed_rpm} rpm is plausible"
    drive.codes[signal] = 2001
    drive.tick()
    alarm = ("speed_step", signal, "alarm")
    assert (found(drive), drive.mode) == ({alarm}, Mode.ACTIVE)
    drive.demanded = dataclasses.replace(THROTTLE, motor_reverse=True)
    for speed_rpm in (1, 0):
        drive.codes[signal] = speed_rpm
        drive.tick()
        assert (commanded(drive, "Throttle"), commanded(drive, "MotorReverse")) == ([0, 0], [0, 0])
    drive.tick()
    assert commanded(drive, "MotorReverse") == [1, 1], "the third plausible one in a row"
    drive.codes |= {f"PCU{number}_Status1.MotorReverse": 1 for number in (1, 2)}
    drive.run(800)
    assert found(drive) == {alarm}
    drive.run(200)
    assert (found(drive), drive.mode) == (set(), Mode.ACTIVE)
    seen(
        f"{controller}: 2000 rpm in 50 ms believed, 2001 reported in the tick after the frame;"
        " a change of direction waited for the third plausible one",
        50,
    )


@pytest.mark.parametrize(("apart_ms", "is_judged"), [(100, True), (150, False)])
def test_f22_motor_speeds_more_than_100_ms_apart_are_not_held_against_each_other(
    apart_ms, is_judged, seen: Seen
):
    drive = driving()
    drive.silent.add("PCU1_Status2")
    drive.run(apart_ms - 50)
    drive.silent.discard("PCU1_Status2")
    drive.codes["PCU1_Status2.MotorSpeed"] = 5000
    drive.run(50)
    told = {("speed_step", "PCU1_Status2.MotorSpeed", "alarm")} if is_judged else set()
    assert (found(drive), drive.mode) == (told, Mode.ACTIVE)
    seen(f"5000 rpm in {apart_ms} ms: {'told' if is_judged else 'not judged'}")


@pytest.mark.parametrize("wheel", [LEFT, RIGHT])
def test_f22_a_wheel_speed_that_jumps_is_told(wheel, seen: Seen):
    drive = driving()
    other = RIGHT if wheel == LEFT else LEFT
    drive.codes = {LEFT: 10_000, RIGHT: 10_000}
    drive.run(1500)
    drive.codes[wheel] = 30_000
    drive.run(200)
    assert found(drive) == set(), "20 km/h is plausible"
    drive.codes = {wheel: 9_999, other: 10_000}
    next_frame(drive, WHEELS)
    alarm = ("wheel_speed_step", wheel, "alarm")
    assert (found(drive), drive.mode) == ({alarm}, Mode.ACTIVE)
    assert commanded(drive, "Throttle") == [pytest.approx(40, abs=0.3)] * 2
    drive.run(2000)
    assert found(drive) == set()
    seen(f"{wheel}: 20 km/h believed, 20.001 reported in the tick after the frame", 50)


# 23: two sources of one thing.


@pytest.mark.parametrize("faster", [LEFT, RIGHT])
def test_f23_wheels_that_differ_for_a_second_are_told(faster, seen: Seen):
    slower = RIGHT if faster == LEFT else LEFT
    drive = driving()
    drive.codes = {faster: 20_000, slower: 5_000}
    drive.run(3000)
    assert found(drive) == set(), "15 km/h is what a turn may do"
    drive.codes[faster] = 20_001
    began_ns = next_frame(drive, WHEELS)
    while drive.now_ns + 50 * MS < began_ns + 1000 * MS:
        drive.tick()
        assert found(drive) == set()
    drive.run(50)
    alarm = ("wheel_speed_difference", WHEELS, "alarm")
    assert (found(drive), drive.mode) == ({alarm}, Mode.ACTIVE)
    told_ms = (drive.now_ns - began_ns) / MS
    drive.codes[faster] = 20_000
    drive.run(1500)
    assert found(drive) == set()
    seen(f"15.001 km/h: reported after {told_ms:.0f} ms; 15 km/h for 3 s: nothing", told_ms)


def test_f23_wheels_that_agree_again_within_the_second_are_not_told(seen: Seen):
    drive = driving()
    for _ in range(4):
        drive.codes = {LEFT: 19_000, RIGHT: 0}
        drive.run(950)
        drive.codes = {}
        drive.run(100)
        assert found(drive) == set()
    seen("950 ms of every 1050 ms: nothing")


# 24: the pedal's two tracks.


def pressed(throttle_pct: float, track2_pct: float) -> ControllerDemand:
    return dataclasses.replace(THROTTLE, throttle_pct=throttle_pct, throttle_track2_pct=track2_pct)


@pytest.mark.parametrize("apart", [(40, 29.9), (29.9, 40)])
def test_f24_tracks_that_differ_take_the_throttle_until_both_are_released(apart, seen: Seen):
    drive = driving(pressed(40, 30))
    assert commanded(drive, "Throttle") == [pytest.approx(40, abs=0.3)] * 2, "10 % are allowed"
    drive.demanded = pressed(*apart)
    for _ in range(3):
        drive.tick()
        assert 0 not in commanded(drive, "Throttle"), "no more than 100 ms yet"
    drive.tick()
    assert commanded(drive, "Throttle") == [0, 0]
    for throttle_pct, track2_pct in ((40, 40), (5, 4.9), (4.9, 5)):
        drive.demanded = pressed(throttle_pct, track2_pct)
        drive.run(500)
        assert commanded(drive, "Throttle") == [0, 0], (throttle_pct, track2_pct)
    drive.demanded = pressed(4.9, 4.9)
    drive.tick()
    drive.demanded = pressed(40, 40)
    drive.run(1000)
    assert commanded(drive, "Throttle") == [pytest.approx(40, abs=0.3)] * 2
    assert (found(drive), drive.mode) == (set(), Mode.ACTIVE)
    seen(f"{apart[0]} % beside {apart[1]} %: throttle 0 once that lasted more than 100 ms", 150)


def test_f24_tracks_that_differ_for_100_ms_again_and_again_take_nothing(seen: Seen):
    drive = driving(pressed(40, 40))
    for _ in range(10):
        drive.demanded = pressed(40, 0)
        drive.run(100)
        drive.demanded = pressed(40, 40)
        drive.run(50)
        assert commanded(drive, "Throttle") == [pytest.approx(40, abs=0.3)] * 2
    seen("two ticks of every three: nothing")


def test_f24_without_the_second_track_a_demand_is_refused_where_it_is_required(seen: Seen):
    drive = Drive(second_track_required=True)
    drive.demanded = pressed(0, 0)
    drive.until(Mode.STANDBY).run(1500)
    assert drive.arm().granted
    drive.demanded = pressed(40, 40)
    drive.run(1000)
    answer = drive.offer(THROTTLE)
    assert (answer.granted, answer.refusal) == (False, Refusal.SECOND_TRACK_MISSING)
    drive.demanded = None
    drive.run(300)
    assert (drive.mode, commanded(drive, "Throttle")) == (Mode.STANDBY, [0, 0])
    seen(answer.sentence)


# 28: regeneration at low speed.

BRAKING = ControllerDemand(brake_pct=30, regen_brake=True)
SPEEDS = ("PCU1_Status2.MotorSpeed", "PCU2_Status2.MotorSpeed")


def regenerates(drive: Drive, *speeds_rpm: int) -> bool:
    """Whether both do after half a second at these speeds; neither of one alone."""
    drive.codes = dict(zip(SPEEDS, speeds_rpm, strict=True))
    drive.run(500)
    told = {frame[:3] for frame in drive.commands}
    assert len(told) == 1, "both the same"
    assert commanded(drive, "Brake")[0] == pytest.approx(30, abs=0.3), "the pedal stays"
    return commanded(drive, "RegenBrake")[0] == 1


def test_f28_regeneration_ends_at_low_speed_and_returns_above(seen: Seen):
    drive = driving(BRAKING)
    assert not regenerates(drive, 0, 0), "at standstill"
    assert not regenerates(drive, 149, 2000)
    assert regenerates(drive, 150, 150)
    assert regenerates(drive, 100, 100)
    drive.codes[SPEEDS[1]] = 99
    drive.tick()
    assert commanded(drive, "RegenBrake") == [0, 0]
    assert not regenerates(drive, 149, 149)
    assert regenerates(drive, 150, 150)
    assert not regenerates(drive, 1000, 6001), "a speed that nobody knows"
    assert drive.mode is Mode.ACTIVE
    seen("off in the tick that hears of 99 rpm, and at a speed not known; on from 150 rpm", 50)


def test_f28_regeneration_at_low_speed_can_be_allowed(seen: Seen):
    drive = driving(BRAKING, regen_min_rpm=0)
    assert regenerates(drive, 0, 0)
    seen("limits.regen_min_rpm 0: also at standstill")


# 30: less torque than commanded.

ENOUGH, TOO_LITTLE = 65, 64  # of 103: 14.9 % and 15.3 % less


@CONTROLLERS
def test_f30_one_controller_that_does_not_obey_stops_both_at_its_second_echo(
    controller, seen: Seen
):
    status1 = f"{controller}_Status1"
    drive = driving()
    drive.codes[f"{status1}.Throttle"] = ENOUGH
    drive.run(3000)
    assert found(drive) == set()
    drive.codes[f"{status1}.Throttle"] = TOO_LITTLE
    next_frame(drive, status1)
    drive.codes = {}
    next_frame(drive, status1)
    drive.codes[f"{status1}.Throttle"] = TOO_LITTLE
    next_frame(drive, status1)
    assert (found(drive), drive.mode) == (set(), Mode.ACTIVE), "one echo between good ones"
    next_frame(drive, status1)
    assert found(drive) == {("echo_below", f"{status1}.Throttle", "stop")}
    assert (drive.mode, drive.commands) == (Mode.FAULT, [ZERO_TORQUE, ZERO_TORQUE])
    seen(f"{controller}: 14.9 % less for 3 s: nothing; 15.3 %: stop in the 2nd echo's tick", 50)


def test_f30_both_controllers_that_do_not_obey_are_an_alarm_and_why_says_so(seen: Seen):
    drive = driving()
    both = [f"PCU{number}_Status1.Throttle" for number in (1, 2)]
    drive.codes = dict.fromkeys(both, 0)
    next_frame(drive, "PCU1_Status1")
    assert found(drive) == set()
    next_frame(drive, "PCU1_Status1")
    assert found(drive) == {("echo_below", signal, "alarm") for signal in both}
    drive.run(3000)
    assert drive.mode is Mode.ACTIVE
    assert all("does not obey" in str(h.finding) for h in _alarms(drive))
    drive.codes = {both[1]: 0}
    next_frame(drive, "PCU1_Status1")
    drive.run(50)
    assert (drive.mode, drive.commands) == (Mode.FAULT, [ZERO_TORQUE, ZERO_TORQUE])
    seen(
        "both: alarm, driving on without torque;"
        " one of them working again: the other stops the vehicle"
    )


def _alarms(drive: Drive):
    return [h for h in drive.gateway.why(drive.now_ns).alarms if h.finding.cause == "echo_below"]


def test_f30_a_throttle_that_rose_in_the_last_second_is_no_lack_of_torque(seen: Seen):
    drive = driving(ControllerDemand())
    drive.codes = {f"PCU{number}_Status1.Throttle": 0 for number in (1, 2)}
    for _ in range(10):
        drive.demanded = dataclasses.replace(THROTTLE, throttle_pct=100)
        drive.run(1400)
        assert (found(drive), drive.mode) == (set(), Mode.ACTIVE)
        drive.demanded = ControllerDemand()
        drive.run(200)
    seen("echo 0 under throttle that was 0 within the second before: nothing")
