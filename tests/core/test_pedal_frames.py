"""Pedals on CAN: each number of docs/safety.md, Pedals, at its limit and one step beyond."""

from dataclasses import replace

import pytest

from tests.core.pedal_node import (
    CODEC,
    PEDALS,
    PERIOD_MS,
    POSITION,
    PedalDrive,
    driving,
    frame_data,
    pressed,
)
from tests.core.simulated_drive import MS, Drive, active
from vcu_gateway.core import calls
from vcu_gateway.core.can_pedals import (
    CanPedals,
    PedalChecksum,
    PedalReader,
    checksum_of,
    of_values,
    values,
)
from vcu_gateway.core.codec import Codec, compile_message
from vcu_gateway.core.curve import Curve
from vcu_gateway.core.demand import CONTROLLERS, ControllerDemand, Demand, PowerMode, Refusal
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.pedal_frames import PedalFault, PedalFrames, expiry_ms
from vcu_gateway.core.supervisor import Mode

NOW_NS = 10_000 * MS
LATER_NS = 10**15


class Node:
    """Frames of the node one after the other, into `PedalFrames` alone."""

    def __init__(self, pedals: CanPedals = PEDALS) -> None:
        self.frames = PedalFrames(pedals, CODEC)
        self.now_ns = NOW_NS
        self.counter = 3

    def sends(self, after_ns=20 * MS, *, counter=None, flip=0, **raws):
        """The demand of a frame that comes after so long."""
        self.now_ns += after_ns
        self.counter = (self.counter + 1) % 15 if counter is None else counter
        frame = Frame(POSITION.can_id, frame_data(self.counter, flip=flip, **raws), self.now_ns)
        return self.frames.demand_of(frame, LATER_NS)

    def asks(self, **raws):
        """Its demand for a controller."""
        demand = self.sends(**raws)
        assert demand.known
        assert set(demand.controllers) == set(CONTROLLERS)
        one, other = demand.controllers.values()
        assert one is other
        return one

    def doubts(self):
        observation = self.frames.observe(self.now_ns)
        return {} if observation is None else dict(observation.doubts)


@pytest.fixture
def node():
    return Node()


# Travel.


@pytest.mark.parametrize(
    ("zone_pct", "raw", "asked_pct"),
    [
        (0, 500, 0),
        (0, 501, 0.04),
        (0, 2999, 99.96),
        (0, 3000, 100),
        (3, 575, 0),
        (3, 576, 100 * 0.04 / 94),
        (3, 1750, 50),
        (3, 2924, 100 - 100 * 0.04 / 94),
        (3, 2925, 100),
        (10, 750, 0),
        (10, 751, 0.05),
        (10, 2749, 99.95),
        (10, 2750, 100),
        (3, 250, 0),
        (3, 3250, 100),
    ],
)
def test_the_travel_asks_for_nothing_and_for_all_within_the_dead_zones(zone_pct, raw, asked_pct):
    node = Node(replace(PEDALS, dead_zone_pct=zone_pct))
    assert node.asks(Throttle1=raw).throttle_pct == pytest.approx(asked_pct, abs=1e-9)


def test_each_pedal_has_its_own_ends(node):
    one = node.asks(Throttle1=1750, Throttle2=500, BrakePressure=155)
    assert one.throttle_pct == pytest.approx(50)
    assert one.throttle_track2_pct == pytest.approx(100 * 17 / 94)
    assert one.brake_pct == pytest.approx(100 * 22 / 94)


def test_a_pedal_may_be_wired_the_other_way_round():
    track = replace(PEDALS.throttle, released=3.75, pressed=0.625)
    node = Node(replace(PEDALS, throttle=track, dead_zone_pct=0))
    assert node.asks(Throttle1=2375).throttle_pct == pytest.approx(25)


# What they say now.


def test_what_the_pedals_say_is_what_their_last_frame_asks_for(node):
    assert PedalFrames(None, CODEC).now(0, 50 * MS) is None
    assert node.frames.now(node.now_ns, 50 * MS).sentence() == "no frame that is a demand"
    node.sends(Throttle1=1750, Throttle2=812, BrakePressure=155)
    now = node.frames.now(node.now_ns, 50 * MS)
    assert (now.message, now.doubts) == ("Pedals_Position", ())
    assert now.difference_pct == pytest.approx(50 - 100 * (44.96 - 3) / 94)
    assert now.sentence() == "throttle 50 %, second track 45 %, difference 5 %, brake 23 %"


def test_a_pedal_that_is_not_believed_says_why_and_has_no_number(node):
    node.sends(Throttle1=0, Throttle2=812)
    now = node.frames.now(node.now_ns, 50 * MS)
    assert (now.throttle_pct, now.difference_pct) == (None, None)
    assert now.sentence() == "second track 45 %, brake 0 %; Throttle1 at -20 % of its travel"
    for _ in range(6):
        node.sends(Throttle1=0)
    node.doubts()
    node.sends()
    assert node.frames.now(node.now_ns, 50 * MS).doubts == (
        "not believed until both tracks are below 5 % for 1 s",
    )


def test_the_last_frames_of_the_pedals_that_are_no_demand_are_told_and_a_silent_one_has_none(node):
    node.sends()
    node.sends(flip=1)
    now = node.frames.now(node.now_ns, 50 * MS)
    assert now.sentence() == (
        "throttle 0 %, second track 0 %, difference 0 %, brake 0 %; checksum wrong"
    )
    came_ns = node.now_ns - 20 * MS
    assert node.frames.now(came_ns + 110 * MS, 50 * MS) == now, "60 ms, and a tick to read it"
    silent = node.frames.now(came_ns + 110 * MS + 1, 50 * MS)
    assert silent.sentence() == "checksum wrong; no frame that is a demand"


def test_bad_frames_are_told_until_a_demand_came(node):
    node.sends(flip=1)
    node.sends(counter=5)
    node.sends()
    assert node.frames.now(node.now_ns, 50 * MS).doubts == ()


def test_what_the_message_does_not_have_is_not_said():
    one = Node(CanPedals(message="Pedals_Position", throttle=PEDALS.throttle))
    one.sends()
    assert one.frames.now(one.now_ns, 50 * MS).sentence() == "throttle 0 %"


def test_what_the_message_does_not_have_is_not_asked_for():
    least = CanPedals(message="Pedals_Position", throttle=PEDALS.throttle, dead_zone_pct=0)
    one = Node(least).asks(Throttle1=1750, BrakePressure=605, ReverseSwitch=1)
    assert one == ControllerDemand(throttle_pct=50, power_mode=PowerMode.ECO)


def test_power_mode_and_regeneration_are_those_of_the_configuration():
    node = Node(replace(PEDALS, power_mode=PowerMode.TURBO, regen_brake=True))
    one = node.asks()
    assert (one.power_mode, one.regen_brake) == (PowerMode.TURBO, True)
    assert one.power_limit_w == 60_000


def test_the_switch_says_the_direction(node):
    assert not node.asks(ReverseSwitch=0).motor_reverse
    assert node.asks(ReverseSwitch=1).motor_reverse


# What is not believed.


@pytest.mark.parametrize(
    ("signal", "good", "beyond", "at"),
    [
        ("Throttle1", 250, 249, -10),
        ("Throttle1", 3250, 3251, 110),
        ("Throttle2", 125, 124, -10),
        ("Throttle2", 1625, 1626, 110),
        ("BrakePressure", 665, 666, 110),
    ],
)
def test_a_pedal_is_not_believed_beyond_10_pct_of_its_travel(node, signal, good, beyond, at):
    raws = {"Throttle1": 1750, "Throttle2": 875, "BrakePressure": 65}
    assert node.sends(**raws | {signal: good}).known
    assert node.doubts() == {}
    demand = node.sends(**raws | {signal: beyond})
    one = demand.controllers["PCU1"]
    assert (demand.known, one.throttle_pct, one.throttle_track2_pct) == (False, 0, 0)
    assert (one.brake_pct > 0) is (signal != "BrakePressure")
    assert node.doubts() == {signal: f"at {at} % of its travel"}


@pytest.mark.parametrize(
    ("signal", "good", "unknown"),
    [("Throttle1", 3250, 4001), ("Throttle2", 1625, 4095), ("BrakePressure", 605, 1001)],
)
def test_a_pedal_that_is_marked_is_not_known(node, signal, good, unknown):
    assert node.sends(**{signal: good}).known
    assert not node.sends(**{signal: unknown}).known
    assert node.doubts() == {signal: "not known"}


@pytest.mark.parametrize("code", [2, 3])
@pytest.mark.parametrize("before", [0, 1])
def test_a_switch_of_another_code_is_not_known_and_the_direction_stays(node, before, code):
    assert node.asks(ReverseSwitch=before).motor_reverse is bool(before)
    demand = node.sends(ReverseSwitch=code)
    assert not demand.known
    assert demand.controllers["PCU2"].motor_reverse is bool(before)
    assert node.doubts() == {"ReverseSwitch": f"code {code} is neither forwards nor reverse"}


@pytest.mark.parametrize(("code", "reverse"), [(0, None), (1, True)])
def test_a_switch_of_a_code_outside_its_own_range_is_not_known(code, reverse):
    signals = tuple(
        replace(one, minimum=1, maximum=1) if one.name == "ReverseSwitch" else one
        for one in POSITION.signals
    )
    reader = PedalReader(PEDALS, compile_message(replace(POSITION, signals=signals)))
    reading = reader.read(reader.decode(frame_data(1, ReverseSwitch=code)))
    assert (reading.reverse, "ReverseSwitch" in reading.doubts) == (reverse, reverse is None)


def test_what_is_not_known_of_a_frame_is_0():
    pedals = replace(COAST, dead_zone_pct=0)
    reader = PedalReader(pedals, compile_message(POSITION))
    unknown = frame_data(1, Throttle1=4095, Throttle2=4095, BrakePressure=1023)
    reading = reader.read(reader.decode(unknown))
    assert (reading.throttle_pct, reading.track2_pct) == (0, 0)
    assert (reading.brake_pct, reading.coast_pct) == (0, 0)
    assert list(reading.doubts) == ["Throttle1", "Throttle2", "BrakePressure"]


def test_every_doubt_since_the_last_tick_is_told_once(node):
    node.sends(Throttle1=0)
    node.sends(Throttle2=0)
    assert node.sends().known
    assert set(node.doubts()) == {"Throttle1", "Throttle2"}
    assert node.doubts() == {}


def test_a_doubt_is_told_while_it_is_the_last_one(node):
    node.sends(Throttle1=0)
    assert node.doubts() == node.doubts() == {"Throttle1": "at -20 % of its travel"}


@pytest.mark.parametrize(("beyond_ns", "latched"), [(0, False), (1, True)])
def test_what_is_not_believed_for_more_than_100_ms_is_latched(node, beyond_ns, latched):
    node.sends(Throttle1=0)
    node.sends(50 * MS, Throttle1=0)
    assert node.sends(50 * MS + beyond_ns).known is not latched
    assert node.sends().known is not latched


def test_a_tick_sees_that_it_lasts_for_more_than_100_ms(node):
    node.sends(Throttle1=0)
    node.frames.observe(node.now_ns + 100 * MS)
    twin = Node()
    twin.sends(Throttle1=0)
    twin.frames.observe(twin.now_ns + 100 * MS + 1)
    assert node.sends().known
    assert not twin.sends().known


def test_frames_that_are_believed_end_the_100_ms(node):
    for _ in range(10):
        assert not node.sends(50 * MS, Throttle1=0).known
        assert node.sends(50 * MS).known


def latched(node):
    for _ in range(7):
        node.sends(Throttle1=0)
    assert not node.sends().known
    node.doubts()
    assert node.doubts() == {"Throttle1": "until both tracks are below 5 % for 1 s"}
    return node


def test_a_latch_ends_with_both_tracks_below_5_pct_for_1_s(node):
    latched(node)
    begun_ns = node.now_ns
    while node.now_ns - begun_ns < 980 * MS:
        assert not node.sends().known
    assert not node.sends(20 * MS - 1).known
    assert node.sends(1).known


@pytest.mark.parametrize(
    ("signal", "raw", "known"),
    [
        ("Throttle1", 624, True),
        ("Throttle1", 625, False),
        ("Throttle2", 312, True),
        ("Throttle2", 313, False),
    ],
)
def test_a_latch_begins_its_second_anew_with_a_track_of_5_pct(signal, raw, known):
    node = latched(Node(replace(PEDALS, dead_zone_pct=0)))
    for _ in range(30):
        node.sends()
    node.sends(**{signal: raw})
    for _ in range(25):
        demand = node.sends()
    assert demand.known is known


def test_a_doubt_begins_the_second_anew(node):
    latched(node)
    for _ in range(30):
        node.sends()
    node.sends(BrakePressure=1000)
    for _ in range(50):
        assert not node.sends().known
    assert node.sends().known


def test_a_latch_outlasts_a_silence_which_begins_the_second_anew(node):
    latched(node)
    for _ in range(49):
        node.sends()
    assert not node.sends(61 * MS).known
    for _ in range(49):
        assert not node.sends().known
    assert node.sends().known


def test_one_track_alone_is_latched_and_released_as_two_are():
    node = latched(Node(CanPedals(message="Pedals_Position", throttle=PEDALS.throttle)))
    assert node.sends(Throttle1=0).controllers["PCU1"].throttle_track2_pct is None
    for _ in range(51):
        demand = node.sends()
    assert demand.known
    assert demand.controllers["PCU1"].throttle_track2_pct is None


def test_a_direction_that_was_never_known_is_forwards(node):
    assert not node.sends(ReverseSwitch=2).controllers["PCU1"].motor_reverse


def test_frames_that_remember_the_same_are_equal():
    one, other = Node(), Node()
    assert one.frames == other.frames
    assert one.frames != one
    assert [one.sends().sequence, one.sends().sequence] == [1, 2]
    assert one.frames != other.frames
    assert one.frames.observe(0) is None


# Frames that are no demand.


def test_the_counter_goes_on_by_one_in_its_range(node):
    assert all(node.sends(counter=counter) for counter in (12, 13, 14, 0, 1))
    assert node.sends(counter=15) is None


@pytest.mark.parametrize("counter", [3, 5, 2])
def test_a_frame_with_another_counter_is_no_demand(node, counter):
    assert node.sends(counter=3) is not None
    assert node.sends(counter=counter) is None
    assert node.sends(counter=counter + 1) is not None
    assert node.frames.rejected == {
        PedalFault.ORDER: 0,
        PedalFault.CHECKSUM: 0,
        PedalFault.COUNTER: 1,
    }


def test_nothing_is_held_against_the_first_counter():
    assert Node().sends(counter=9) is not None


@pytest.mark.parametrize("bit", range(8))
def test_a_frame_whose_checksum_has_a_wrong_bit_is_no_demand(node, bit):
    assert node.sends() is not None
    assert node.sends(flip=1 << bit) is None
    assert node.sends() is not None
    assert node.frames.rejected[PedalFault.CHECKSUM] == 1


@pytest.mark.parametrize(("kind", "checksum"), [("xor", 0x31), ("sum", 0xDD), ("sae_j1850", 0x4B)])
def test_the_checksums_are_those_of_the_books(kind, checksum):
    assert checksum_of(b"123456789", kind) == checksum
    assert checksum_of(b"", "sae_j1850") == 0


@pytest.mark.parametrize(
    ("data", "checksum"),
    [
        ("00000000", 0x59),
        ("f20183", 0x37),
        ("0faa0055", 0x79),
        ("00ff5511", 0xB8),
        ("332255aabbccddeeff", 0xCB),
        ("926b55", 0x8C),
        ("ffffffff", 0x74),
    ],
)
def test_sae_j1850_gives_what_autosar_prints(data, checksum):
    assert checksum_of(bytes.fromhex(data), "sae_j1850") == checksum


@pytest.mark.parametrize("own", [0, 3, 7])
@pytest.mark.parametrize("kind", ["xor", "sum", "sae_j1850"])
def test_a_checksum_is_over_every_byte_but_its_own(kind, own):
    throttle, checksum = POSITION.signal("Throttle1"), POSITION.signal("Checksum")
    signals = replace(throttle, start_bit=8), replace(checksum, start_bit=8 * own)
    pedals = CanPedals(
        message="P", throttle=PEDALS.throttle, checksum=PedalChecksum("Checksum", kind)
    )
    reader = PedalReader(pedals, compile_message(replace(POSITION, signals=signals)))
    rest = bytes([1, 2, 3, 4, 5, 6, 7])
    good = rest[:own] + bytes([checksum_of(rest, kind)]) + rest[own:]
    assert reader.checksum_holds(good)
    for place in range(8):
        bad = bytearray(good)
        bad[place] ^= 0x10
        assert not reader.checksum_holds(bad)


def test_a_frame_older_than_the_one_before_is_no_demand_and_no_step(node):
    assert node.sends() is not None
    assert node.sends(-1) is None
    node.counter -= 1
    assert node.sends(1) is not None
    assert node.frames.rejected[PedalFault.ORDER] == 1


def test_bad_frames_in_a_row_are_told_with_the_last_reason(node):
    for run in range(1, 5):
        assert node.sends(flip=1) is None
        observation = node.frames.observe(node.now_ns)
        assert (observation.bad_frames, observation.bad) == (run, "checksum wrong")
    assert node.frames.observe(node.now_ns).bad_frames == 4
    node.sends()
    assert node.frames.observe(node.now_ns).bad_frames == 4
    assert node.frames.observe(node.now_ns) is None


def test_a_stamp_of_the_future_counts_as_now(node):
    node.sends(1000 * MS)
    frame = Frame(POSITION.can_id, frame_data(5), node.now_ns + 500 * MS)
    assert node.frames.demand_of(frame, node.now_ns).made_ns == node.now_ns
    assert node.sends(MS, counter=6) is not None


# Expiry.


@pytest.mark.parametrize(
    ("period_ms", "expires_ms"), [(10, 60), (20, 60), (21, 63), (50, 150), (66, 198), (67, 200)]
)
def test_a_demand_expires_after_3_periods_at_least_60_and_at_most_200_ms(period_ms, expires_ms):
    assert expiry_ms(period_ms) == expires_ms


@pytest.mark.parametrize(("beyond_ns", "silent"), [(0, False), (1, True)])
def test_silence_is_counted_from_the_last_frame_that_was_a_demand(node, beyond_ns, silent):
    node.sends()
    good_ns = node.now_ns
    node.sends(flip=1)
    assert node.frames.silent(good_ns + 60 * MS + beyond_ns) is silent
    assert node.sends(40 * MS + beyond_ns).resumed is silent


def test_a_message_of_another_period_expires_by_it():
    message = replace(POSITION, period_ms=50)
    frames = PedalFrames(PEDALS, Codec(replace(CODEC.protocol, messages=(message,))))
    assert frames.demand_of(Frame(message.can_id, frame_data(1), NOW_NS), NOW_NS) is not None
    assert [frames.silent(NOW_NS + 150 * MS + beyond_ns) for beyond_ns in (0, 1)] == [False, True]
    assert frames.ttl_ms(50 * MS) == 200


def test_without_a_demand_there_is_silence(node):
    assert node.frames.silent(0)
    assert node.sends().resumed


# Coasting.

COAST = replace(PEDALS, dead_zone_pct=3, coast_brake=Curve(((0.0, 15.0), (5.0, 0.0))))


@pytest.mark.parametrize(
    ("raws", "brake_pct", "regen"),
    [
        ({}, 15, True),
        ({"Throttle1": 250}, 15, True),
        ({"Throttle1": 550, "Throttle2": 275}, 9, True),
        ({"Throttle1": 550}, 9, True),
        ({"Throttle2": 275}, 9, True),
        ({"Throttle1": 624}, 0.12, True),
        ({"Throttle1": 625}, 0, False),
        ({"BrakePressure": 107}, 100 * 14 / 94, True),
        ({"BrakePressure": 108}, None, False),
        ({"Throttle2": 4095}, 0, False),
    ],
)
def test_a_released_pedal_coasts_with_the_curve_at_the_higher_track(raws, brake_pct, regen):
    demand = Node(COAST).sends(**raws)
    one = demand.controllers["PCU1"]
    if raws == {"BrakePressure": 107}:
        brake_pct = 15  # 14.9 % are asked for
    elif brake_pct is None:
        brake_pct = 100 * (103 / 6 - 3) / 94
    assert one.brake_pct == pytest.approx(brake_pct)
    assert one.regen_brake is regen


def test_coasting_ends_where_the_frame_is_latched():
    node = latched(Node(COAST))
    assert node.sends().controllers["PCU1"].brake_pct == 0


def test_without_the_curve_nothing_coasts(node):
    one = node.asks()
    assert (one.brake_pct, one.regen_brake) == (0, False)


def test_pedals_come_back_from_their_values():
    full = replace(COAST, power_mode=PowerMode.TURBO, regen_brake=True)
    least = CanPedals(message="Pedals_Position", throttle=PEDALS.throttle)
    assert [of_values(values(one)) for one in (full, least)] == [full, least]


# In a drive.


def test_the_pedal_drives():
    drive = driving(50)
    assert drive.mode is Mode.ACTIVE
    assert drive.throttles == [128, 128]
    assert drive.gateway.requests.arbiter.current.source == "pedals"
    assert {"source": "pedals"} in [
        dict(e.fields) for e in drive.events if e.name == "demand_owner"
    ]


def test_without_the_key_a_frame_of_the_node_is_a_message_like_any_other():
    drive = driving(50)
    plain = active()
    plain.gateway.receive(Frame(POSITION.can_id, frame_data(1), plain.now_ns))
    assert plain.gateway.receiver.pedal_frames == []
    assert drive.gateway.counters.rejected.keys() > plain.gateway.counters.rejected.keys()


def test_a_frame_that_is_not_believed_holds_the_tick_whatever_follows_it():
    drive = driving(50)
    drive.pedal(drive.now_ns + 1, Throttle1=0)
    drive.tick()
    assert drive.throttles == [0, 0]
    drive.tick()
    assert drive.throttles == [13, 13]
    assert drive.mode is Mode.ACTIVE


def test_after_100_ms_without_belief_throttle_is_0_until_both_tracks_were_released():
    drive = driving(50)
    drive.feet = pressed(50) | {"Throttle2": 0}
    drive.run(200)
    drive.feet = pressed(50)
    drive.run(2000)
    assert (drive.throttles, drive.mode) == ([0, 0], Mode.ACTIVE)
    assert "Pedals_Position.Throttle2 until both tracks are below 5 % for 1 s" in drive.sentence
    drive.feet = pressed(0)
    drive.run(1100)
    drive.feet = pressed(50)
    drive.run(100)
    assert drive.throttles[0] > 0


def test_a_pedal_that_is_not_believed_releases_no_latch():
    drive = driving(50)
    drive.feet = pressed(50, brake_pct=30)
    drive.tick()
    drive.feet = pressed(50) | {"Throttle1": 0}
    drive.run(100)
    drive.feet = pressed(50)
    drive.run(500)
    assert drive.throttles == [0, 0]
    assert "brake over throttle" in drive.sentence


def test_a_pedal_that_is_not_believed_is_no_released_one_for_arming():
    drive = driving()
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.feet = {"Throttle1": 0}
    drive.run(400)
    assert "has not been 0 for 200 ms" in drive.arm().sentence


def test_tracks_that_differ_take_the_throttle_as_those_of_any_demand():
    drive = driving(50)
    drive.feet = pressed(50) | {"Throttle2": pressed(30)["Throttle2"]}
    drive.run(100)
    assert drive.throttles[0] > 0
    drive.run(100)
    assert drive.throttles == [0, 0]
    assert "the pedal's tracks differ" in drive.sentence


def test_a_doubt_does_not_end_the_difference_of_the_tracks():
    drive = driving(50)
    differing = pressed(50) | {"Throttle2": pressed(30)["Throttle2"]}
    for _ in range(3):
        drive.feet = differing
        drive.tick()
        drive.feet = differing | {"BrakePressure": 1001}
        drive.tick()
    assert "the pedal's tracks differ" in drive.sentence


def silent_for(drive: PedalDrive, ticks: int) -> None:
    drive.speaks = False
    for _ in range(ticks):
        drive.tick()


def test_silence_of_more_than_60_ms_ends_the_drive():
    drive = driving(50)
    last_ns = drive.now_ns // (20 * MS) * 20 * MS
    silent_for(drive, 1)
    age_ns = drive.now_ns - last_ns
    assert (drive.mode is Mode.ACTIVE) is (age_ns <= 60 * MS)
    drive.tick()
    assert (drive.mode, drive.throttles) == (Mode.STANDBY, [0, 0])
    assert "no fresh demand" in drive.arm().sentence


def test_a_gap_between_two_ticks_ends_the_drive_though_frames_came_after_it():
    drive = driving(50)
    drive.speaks = False
    drive.tick(55 * MS - drive.now_ns % (20 * MS))
    assert drive.mode is Mode.ACTIVE
    drive.pedal(drive.now_ns + 10 * MS)
    drive.tick()
    assert drive.mode is Mode.STANDBY


def test_bad_frames_alone_end_the_drive_with_an_alarm():
    drive = driving(50)
    drive.speaks = False
    for number in range(1, 5):
        drive.pedal(drive.now_ns + number * 20 * MS, flip=1)
    drive.tick(85 * MS)
    assert (drive.mode, drive.throttles) == (Mode.STANDBY, [0, 0])
    assert "Pedals_Position checksum wrong, 4 frames in a row" in drive.sentence
    assert drive.gateway.counters.rejected[PedalFault.CHECKSUM] == 4


def test_a_late_tick_reads_what_came_meanwhile_and_expires_nothing():
    drive = driving(50)
    drive.tick(190 * MS)
    assert drive.mode is Mode.ACTIVE
    assert drive.throttles == [128, 128]


def test_a_request_late_in_the_period_finds_the_pedals_as_the_tick_did():
    drive = driving()
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.run(300)
    drive.speaks = False
    drive.pedal(drive.now_ns + 30 * MS)
    drive.tick()
    drive.now_ns += 49 * MS  # the last frame that was read came 69 ms ago
    assert drive.arm().granted


def test_a_frame_read_after_a_later_demand_of_the_owner_ends_nothing():
    drive = PedalDrive()
    drive.speaks, drive.demanded = False, ControllerDemand()
    drive.until(Mode.STANDBY)
    drive.run(1500)
    assert drive.arm().granted
    drive.pedal(drive.now_ns + 10 * MS)
    drive.tick()
    assert drive.mode is Mode.ACTIVE
    assert drive.gateway.requests.arbiter.current.source == "driver"


def offered(drive: Drive, source: str, after_ns: int = 0) -> Refusal | None:
    demands = dict.fromkeys(CONTROLLERS, ControllerDemand())
    now_ns = drive.now_ns + after_ns
    return drive.gateway.apply(calls.Offer(Demand(source, 10**9, 200, demands), now_ns)).refusal


def test_nobody_else_takes_the_pedals_name_or_their_demand():
    drive = driving(50)
    for after_ns in (0, 49 * MS):
        assert offered(drive, "pedals", after_ns) is Refusal.NAME_RESERVED
        assert offered(drive, "joystick", after_ns) is Refusal.OTHER_OWNER
    answer = drive.gateway.apply(calls.EndDemand("pedals", drive.now_ns))
    assert answer.refusal is Refusal.NAME_RESERVED
    drive.tick()
    assert (drive.mode, drive.throttles) == (Mode.ACTIVE, [128, 128])


def test_without_pedals_on_can_their_name_is_a_name_like_any_other():
    drive = Drive()
    assert offered(drive, "pedals") is None


def test_a_source_of_higher_priority_takes_over_and_the_pedals_come_back_after_it():
    drive = driving(50, priorities={"remote": 1})
    assert offered(drive, "remote", MS) is None
    drive.tick()
    assert (drive.mode, drive.throttles) == (Mode.ACTIVE, [0, 0])
    drive.run(250)
    assert drive.mode is Mode.STANDBY
    drive.run(100)
    assert drive.gateway.requests.arbiter.current.source == "pedals"


def test_a_pedal_pressed_before_arm_and_read_after_it_ends_the_drive():
    drive = driving()
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.run(300)
    drive.now_ns += 30 * MS
    assert drive.arm().granted
    drive.now_ns -= 30 * MS
    drive.feet = pressed(20)
    drive.tick()
    assert (drive.mode, drive.throttles) == (Mode.STANDBY, [0, 0])


def test_a_pedal_pressed_in_the_instant_of_arming_drives():
    drive = driving()
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.run(300)
    after_ns = PERIOD_MS * MS - drive.now_ns % (PERIOD_MS * MS)
    drive.now_ns += after_ns
    assert drive.arm().granted
    drive.now_ns -= after_ns
    drive.feet = pressed(20)
    drive.tick()
    assert drive.mode is Mode.ACTIVE


def test_a_pressed_pedal_ends_no_drive_of_another_owner():
    drive = PedalDrive(priorities={"driver": 1}).until(Mode.STANDBY)
    drive.demanded = ControllerDemand()
    drive.run(1500)
    drive.feet = pressed(20)
    drive.now_ns += 30 * MS
    assert drive.arm().granted
    drive.demanded = ControllerDemand(throttle_pct=20)
    assert drive.offer(drive.demanded).granted
    drive.now_ns -= 30 * MS
    drive.tick()
    assert drive.mode is Mode.ACTIVE


def test_a_released_pedal_before_arm_that_is_read_after_it_ends_nothing():
    drive = driving()
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.run(300)
    drive.now_ns += 45 * MS
    assert drive.arm().granted
    drive.now_ns -= 45 * MS
    drive.tick()
    assert drive.mode is Mode.ACTIVE


def test_a_pedal_pressed_after_arm_drives():
    drive = driving()
    drive.gateway.apply(calls.Disarm(drive.now_ns))
    drive.run(300)
    assert drive.arm().granted
    drive.feet = pressed(20)
    drive.run(100)
    assert drive.throttles[0] > 0


def test_the_other_direction_waits_as_for_any_demand():
    drive = driving(50)
    drive.turn(900)
    drive.feet = pressed(50) | {"ReverseSwitch": 1}
    drive.tick()
    assert drive.throttles == [0, 0]
    drive.turn(0)
    drive.run(200)
    assert all(command[0] & 0x10 for command in drive.commands)


def test_a_static_demand_of_a_bench_stays_the_owner():
    drive = PedalDrive(bench_demand=ControllerDemand(throttle_pct=10))
    drive.run(300)
    assert drive.gateway.requests.arbiter.current.source == "bench"


def test_without_pedals_in_the_configuration_no_frame_is_a_demand():
    gateway = Drive().gateway
    frame = Frame(0x18FF0001, bytes(8), NOW_NS)
    assert gateway.requests.pedal_frames.demand_of(frame, NOW_NS) is None
