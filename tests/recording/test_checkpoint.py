"""Checkpoints: a core restored from one goes on as the core did that it was taken of."""

import copy
import json
import os
import subprocess
import sys
import time
from dataclasses import fields, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.core.pedal_node import CODEC as PEDAL_CODEC
from tests.core.pedal_node import PEDALS, driving, pressed
from tests.core.simulated_drive import CODEC, MS, Drive, active, in_mode
from tests.recording.graphs import DifferenceError, compare
from vcu_gateway.core import calls
from vcu_gateway.core.can_pedals import CanPedals, PedalTrack
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import LinkState
from vcu_gateway.core.pedal_frames import PedalFrames
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.core.tuning import Tuning
from vcu_gateway.recording.checkpoint import StateError, restore, state_of

# Decides nothing; the frames that follow a checkpoint tell it anew.
MADE_AGAIN = ("_arrived", "taken", "echoes", "_stop_watch", "_last")
BUS_OFF, RESTARTED = 0x040, 0x100


def through_json(state):
    return json.loads(json.dumps(state, allow_nan=False))


def restored(drive: Drive, settings: Settings | None = None) -> Gateway:
    state = through_json(state_of(drive.gateway))
    return restore(state, CODEC, settings or drive.gateway.settings)


def busy_drive(mode: Mode = Mode.ACTIVE) -> Drive:
    """A drive with something in every part of the core."""
    drive = in_mode(mode)
    drive.codes["BMS_Status.CellUndervoltage"] = 1
    drive.turn(900, 950)
    drive.demanded = ControllerDemand(throttle_pct=20, throttle_track2_pct=35)
    drive.run(300)
    drive.gateway.receive(Frame(0x0000BEEF, bytes(8), drive.now_ns))
    drive.gateway.receive(Frame(BUS_OFF, bytes(8), drive.now_ns, error=True))
    drive.gateway.receive(Frame(RESTARTED, bytes(8), drive.now_ns + 1, error=True))
    drive.receive("BMS_Status")
    drive.gateway.apply(calls.EmergencyStop())
    drive.gateway.apply(calls.NoteRestartState("No space"))
    return drive


@pytest.mark.parametrize("mode", Mode, ids=lambda mode: mode.name)
def test_a_core_is_restored_object_by_object(mode):
    drive = busy_drive(mode)
    compare(drive.gateway, restored(drive), left_out=MADE_AGAIN)


@pytest.mark.parametrize("mode", Mode, ids=lambda mode: mode.name)
def test_a_restored_core_gives_the_same_from_then_on(mode):
    drive = busy_drive(mode)
    twin = drive.twin()
    twin.gateway = restored(drive)
    for _ in range(60):
        assert drive.sentence == twin.sentence
        assert drive.tick()[1:] == twin.tick()[1:]
    assert drive.gateway.counters == twin.gateway.counters


def test_what_arrived_since_the_last_tick_is_judged_by_the_next_one():
    drive = active()
    drive.codes["BMS_Status.InternalFault"] = 1
    drive.receive("BMS_Status")
    drive.codes["BMS_Status.InternalFault"] = 0
    drive.receive("BMS_Status")
    twin = drive.twin()
    twin.gateway = restored(drive)
    assert (drive.tick().mode, twin.tick().mode) == (Mode.FAULT, Mode.FAULT)


def test_a_bus_off_between_two_ticks_counts_once_as_it_did():
    """The link monitor compares by identity."""
    drive = active()
    drive.gateway.receive(Frame(BUS_OFF, bytes(8), drive.now_ns, error=True))
    drive.gateway.receive(Frame(RESTARTED, bytes(8), drive.now_ns + 1, error=True))
    drive.tick()
    twin = drive.twin()
    twin.gateway = restored(drive)
    states = []
    for one in (drive, twin):
        one.tick()
        states.append(one.gateway.link.state)
    assert states == [LinkState.UP, LinkState.UP]


def test_the_state_of_a_restored_core_is_the_same_text():
    drive = busy_drive()
    drive.tick()  # what arrived before the last tick is left out
    state = state_of(drive.gateway)
    assert json.dumps(state_of(restored(drive))) == json.dumps(state)


def test_a_state_from_before_the_restart_state_is_read_as_one_that_was_kept():
    kept, failed = Drive(), Drive()
    failed.gateway.apply(calls.NoteRestartState("No space"))
    requests = state_of(kept.gateway)["Gateway"]["requests"]["OperatorRequests"]
    assert "restart_state_failure" not in requests
    assert restored(kept).requests.restart_state_failure is None
    assert restored(failed).requests.restart_state_failure == "No space"


def test_pedals_on_can_go_on_from_a_state_as_they_did():
    """With frames that came since the tick, a run of bad ones, and a pedal that is not believed."""
    drive = driving(40)
    drive.feet |= {"Throttle2": 0}
    drive.run(200)
    drive.pedal(drive.now_ns + MS, flip=1)
    twin = drive.twin()
    twin.gateway = restore(
        through_json(state_of(drive.gateway)), PEDAL_CODEC, drive.gateway.settings
    )
    compare(drive.gateway, twin.gateway, left_out=MADE_AGAIN)
    for one in (drive, twin):
        one.feet = pressed(0)
    for _ in range(30):
        assert drive.sentence == twin.sentence
        assert drive.tick()[1:] == twin.tick()[1:]
    assert drive.gateway.counters == twin.gateway.counters


def test_without_pedals_on_can_a_state_says_nothing_of_them():
    assert "edal_" not in json.dumps(state_of(busy_drive().gateway))


def test_a_state_from_before_the_pedals_begins_them_anew():
    drive = active()
    settings = replace(drive.gateway.settings, pedals=PEDALS)
    gateway = restore(through_json(state_of(drive.gateway)), PEDAL_CODEC, settings)
    assert gateway.requests.pedal_frames == PedalFrames(PEDALS, PEDAL_CODEC)
    assert gateway.requests.pedal_frames.silent(drive.now_ns)


def test_a_state_holds_no_number_that_json_does_not_have():
    text = json.dumps(state_of(Drive().gateway), allow_nan=False)
    assert '{"float": "-inf"}' in text


@pytest.mark.parametrize("name", [item.name for item in fields(Settings)])
def test_what_the_settings_give_is_not_in_the_state(name):
    """So that a drive goes on from its middle with other settings."""
    drive = active()
    other = replace(drive.gateway.settings, **{name: OTHER[name]})
    gateway = restored(drive, other)
    fresh = Gateway(CODEC, other, drive.now_ns)
    assert gateway.settings == other
    assert gateway.requests.terms == fresh.requests.terms
    assert gateway.transmitter.gate.limits == fresh.transmitter.gate.limits
    assert gateway.transmitter._can_ids == fresh.transmitter._can_ids
    for path in ("receiver.store._stale_after_ns", "_collector._late_after_ns"):
        assert _at(gateway, path) == _at(fresh, path), path
    assert gateway._modes._period_ns == fresh._modes._period_ns
    assert gateway._listening._listen_ns == fresh._listening._listen_ns


OTHER: dict[str, Any] = {
    "pedals": CanPedals(message="IMU_Attitude", throttle=PedalTrack("AttitudeX", 0, 50)),
    "stale_after_ms": {"BMS_Status": 777},
    "late_after_ms": {"BMS_Status": 555},
    "transmit_priority": 3,
    "period_ns": 20 * MS,
    "speed_limit_max_rpm": 700,
    "power_limit_max_w": 701,
    "derated_power_w": 702,
    "regen_limit_pct": 7.0,
    "throttle_slew_pct_per_s": 17.0,
    "power_slew_w_per_s": 6_001.0,
    "regen_slew_pct_per_s": 11.0,
    "speed_slew_rpm_per_s": 501.0,
    "power_return_w_per_s": 101.0,
    "brake_return_pct_per_s": 2.0,
    "speed_fall_rpm_per_s": 101.0,
    "speed_return_rpm_per_s": 102.0,
    "tuning": Tuning({"brake_pct.by_soc_pct": Curve(((90, 100), (98, 0)))}),
    "direction_change_rpm": 1.0,
    "regen_min_rpm": 2.0,
    "required_messages": ("BMS_Status", "PCU1_Status2", "PCU2_Status2", "IMU_Attitude"),
    "listen_before_talk_ms": 1_001,
    "qualify_frames": 9,
    "clear_hold_ms": 1_003,
    "echo_below_max_pct": 9.0,
    "motor_speed_step_max_rpm": 501.0,
    "wheel_speed_step_max_kmh": 6.0,
    "wheel_speed_difference_max_kmh": 2.0,
    "ttl_max_ms": 500,
    "ttl_default_ms": 100,
    "priorities": {"driver": 1},
    "independent_directions": True,
    "second_track_required": True,
    "bench_demand": ControllerDemand(throttle_pct=1),
    "auto_arm": True,
}

BEGUN_WITH = {
    # What the first ticks start from: state from then on.
    "speed_limit_max_rpm": {"_before"},
    "power_limit_max_w": {"_ramps"},
    "listen_before_talk_ms": {"_quiet_until_ns"},
    "bench_demand": {"current"},
    "auto_arm": set(),
}


@pytest.mark.parametrize("name", [item.name for item in fields(Settings)])
def test_a_setting_is_in_the_state_only_where_it_is_a_first_value(name):
    """An attribute that the settings give, and that is kept, would outlive a change of them."""
    one = state_of(Gateway(CODEC, Settings(), 5))
    other = state_of(Gateway(CODEC, replace(Settings(), **{name: OTHER[name]}), 5))
    assert set(_different(one, other)) == BEGUN_WITH.get(name, set())


def _different(one, other, name=""):
    """The innermost attributes with different values."""
    if isinstance(one, dict) and isinstance(other, dict) and one.keys() == other.keys():
        for key in one:
            inner = name if key[0].isupper() or key in ("dict", "tuple") else key
            yield from _different(one[key], other[key], inner)
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for item, its in zip(one, other, strict=True):
            yield from _different(item, its, name)
    elif one != other:
        yield name


def _at(one, path):
    for name in path.split("."):
        one = getattr(one, name)
    return one


class NewPart:
    """A part of a later version."""


def test_an_attribute_that_no_checkpoint_can_hold_is_an_error():
    drive = Drive()
    vars(drive.gateway.supervisor)["news"] = NewPart()
    with pytest.raises(TypeError, match=r"cannot hold tests.*NewPart"):
        state_of(drive.gateway)


def test_an_attribute_that_is_forgotten_is_found_by_the_comparison():
    drive, twin = busy_drive(), restored(busy_drive())
    twin.supervisor.since_ns += 1
    with pytest.raises(DifferenceError, match="since_ns"):
        compare(drive.gateway, twin, left_out=MADE_AGAIN)


def test_an_object_that_is_shared_no_more_is_found_by_the_comparison():
    drive = busy_drive()
    twin = restored(drive)
    twin.causes = copy.deepcopy(twin.causes)
    with pytest.raises(DifferenceError, match="shared"):
        compare(drive.gateway, twin, left_out=MADE_AGAIN)


def replaced(state, path, value):
    """The state with one place changed."""
    changed = copy.deepcopy(state)
    inner = changed
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return changed


SUPERVISOR = ("Gateway", "supervisor")


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        (("Gateway",), {}, "Gateway has other attributes in this version: _collector"),
        (("Gateway", "_speeds"), {"NoSuch": []}, "this version has no NoSuch"),
        (("Gateway", "_speeds"), {"Supervisor": {}}, "Supervisor stands where"),
        (("Gateway", "_speeds"), {"Mode": []}, "this version has no Mode"),
        (("Gateway", "_speeds"), {"MotorSpeeds": [1]}, "MotorSpeeds has 1 fields, here 2"),
        (("Gateway", "_speeds"), {"ref": 10**6}, "object 1000000, which is not there"),
        (("Gateway", "_speeds"), {"ref": -1}, "object -1, which is not there"),
        (("Gateway", "_speeds"), {"ref": True}, "object True, which is not there"),
        (("Gateway", "_speeds"), {"enum": ["Mode", "FLYING"]}, "no Mode.FLYING"),
        (("Gateway", "_speeds"), {"enum": ["Modus", "ACTIVE"]}, "no enumeration 'Modus'"),
        (("Gateway", "_speeds"), {"bytes": "0g"}, "damaged"),
        (("Gateway", "_speeds"), {"float": "1"}, "damaged"),
        (("Gateway", "_speeds"), {}, "damaged"),
        (("Gateway", "_speeds"), [], "a list without its kind"),
        (("Gateway", "_speeds"), {"deque": []}, "damaged"),
        (("Gateway", "_speeds"), {"set": [{"list": []}]}, "damaged"),
    ],
    ids=lambda value: str(value)[:30],
)
def test_a_state_that_does_not_fit_is_refused_with_its_place(path, value, reason):
    state = through_json(state_of(busy_drive().gateway))
    with pytest.raises(StateError, match=reason):
        restore(replaced(state, path, value), CODEC, Settings())


@pytest.mark.parametrize("state", [None, [], {}, 5, {"Receiver": {}}, {"Gateway": None}])
def test_what_is_no_state_is_refused(state):
    with pytest.raises(StateError):
        restore(state, CODEC, Settings())


def test_a_state_whose_object_holds_itself_is_refused():
    state = through_json(state_of(Drive().gateway))
    with pytest.raises(StateError, match="holds itself"):
        restore(
            replaced(state, ("Gateway", "_collector"), {"tuple": [{"ref": 1}]}), CODEC, Settings()
        )


@given(data=st.data())
def test_a_damaged_state_is_restored_or_refused_never_more(data):
    text = bytearray(json.dumps(state_of(busy_drive_once().gateway)).encode())
    for _ in range(data.draw(st.integers(1, 3))):
        text[data.draw(st.integers(0, len(text) - 1))] = data.draw(st.sampled_from(b'{}[]",:0a-'))
    try:
        state = json.loads(text)
    except ValueError:
        return
    try:
        restore(state, CODEC, Settings())
    except StateError:
        return


BUSY: list[Drive] = []


def busy_drive_once() -> Drive:
    if not BUSY:
        BUSY.append(busy_drive())
    return BUSY[0]


def test_a_checkpoint_takes_a_tenth_of_a_period_at_the_most():
    """5 ms once a minute, after the frames have left."""
    drive = busy_drive()
    took_s = []
    for _ in range(10):
        began_s = time.perf_counter()
        json.dumps(state_of(drive.gateway))
        took_s.append(time.perf_counter() - began_s)
    assert min(took_s) < 0.005


def test_the_text_is_the_same_whatever_order_python_gives_its_sets():
    program = (
        "import json; from tests.recording.test_checkpoint import busy_drive, state_of;"
        "print(json.dumps(state_of(busy_drive().gateway)))"
    )
    texts = [
        subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("1", "2")
    ]
    assert texts[0] == texts[1] != b""
