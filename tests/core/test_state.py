"""The store keeps the newest of each message and a snapshot never changes."""

import pytest

from tests.conftest import payload
from vcu_gateway.core.state import FUTURE_TOLERANCE_NS, Quality, Store

MS = 1_000_000
STATUS = "BMS_Status"
STALE_NS = 1600 * MS


@pytest.fixture
def store(protocol):
    received = protocol.received_by("VCU")
    return Store(received, {message.name: STALE_NS for message in received})


@pytest.fixture
def put(codec, store):
    def put(at_ns, message=STATUS, **values):
        decoded = codec.by_name[message].decode(payload(codec, message, values))
        store.put(message, decoded, at_ns)

    return put


def test_before_the_first_frame_everything_is_never_and_none(store):
    snapshot = store.snapshot(0)
    assert snapshot.latest(STATUS) is None
    assert snapshot.age_ns(STATUS) is None
    assert snapshot.stale(STATUS)
    for message in snapshot.messages:
        for reading in snapshot.readings(message.name):
            assert reading.quality is Quality.NEVER
            assert reading.value is reading.raw is None
            assert reading.code_name is None


def test_a_reading_has_value_raw_unit_quality_and_name(store, put):
    put(100 * MS, PackVoltage=52.34, SOC=80, CellUndervoltage=1)
    snapshot = store.snapshot(130 * MS)
    voltage = snapshot.reading(STATUS, "PackVoltage")
    assert voltage.value == pytest.approx(52.34)
    assert (voltage.raw, voltage.unit, voltage.quality) == (5234, "V", Quality.GOOD)
    assert snapshot.age_ns(STATUS) == 30 * MS
    assert voltage.code_name is None
    assert snapshot.reading(STATUS, "CellUndervoltage").code_name == "level1"


def test_a_snapshot_does_not_change_when_more_frames_arrive(store, put):
    put(100 * MS, SOC=80)
    snapshot = store.snapshot(110 * MS)
    put(120 * MS, SOC=20)
    put(121 * MS, "BMS_Temperatures", PackTemperature1=20)
    assert snapshot.reading(STATUS, "SOC").value == 80
    assert snapshot.latest("BMS_Temperatures") is None
    assert store.snapshot(130 * MS).reading(STATUS, "SOC").value == 20


def test_a_value_is_stale_one_nanosecond_after_its_deadline(store, put):
    put(0, SOC=80)
    assert store.snapshot(STALE_NS).reading(STATUS, "SOC").quality is Quality.GOOD
    late = store.snapshot(STALE_NS + 1).reading(STATUS, "SOC")
    assert late.quality is Quality.STALE
    assert late.value == 80, "a stale value is kept"


def test_the_values_of_a_stale_message_are_not_relied_upon(store, put):
    put(0, "PCU1_Status2", MotorSpeed=40)
    assert list(store.snapshot(STALE_NS).good_values("PCU1_Status2", "MotorSpeed")) == [40]
    assert store.snapshot(STALE_NS + 1).good_values("PCU1_Status2", "MotorSpeed") == ()


def test_one_value_out_of_range_since_the_tick_before_spoils_the_others(store, put, codec):
    put(0, "PCU1_Status2", MotorSpeed=40)
    store.put("PCU1_Status2", codec.by_name["PCU1_Status2"].decode(b"\xff" * 8), 1)
    put(2, "PCU1_Status2", MotorSpeed=40)
    assert store.take(3).good_values("PCU1_Status2", "MotorSpeed") == ()


def test_of_several_frames_the_highest_code_of_each_signal_is_told_last(store, put):
    put(0, SOC=80, CellUndervoltage=0)
    put(1, SOC=20, CellUndervoltage=2)
    assert store.take(2).codes(STATUS, ("SOC", "CellUndervoltage")) == [(20, 0), (80, 2)]


def test_of_frames_that_do_not_differ_one_row_of_codes_is_told(store, put):
    for at_ns in range(3):
        put(at_ns, SOC=80, CellUndervoltage=2)
    assert store.take(3).codes(STATUS, ("SOC", "CellUndervoltage")) == [(80, 2)]


def test_a_stamp_slightly_ahead_is_fresh_and_one_far_ahead_is_not(store, put):
    put(FUTURE_TOLERANCE_NS + 5, SOC=80)
    snapshot = store.snapshot(5)
    assert not snapshot.stale(STATUS)
    assert snapshot.age_ns(STATUS) == 0
    assert store.snapshot(4).stale(STATUS)


def test_out_of_range_and_saturated_values_are_kept_and_marked(codec, store):
    decoded = codec.by_name[STATUS].decode(bytes([0xFF, 0xFF, 0, 0, 102, 0, 0, 0]))
    store.put(STATUS, decoded, 0)
    snapshot = store.snapshot(0)
    soc = snapshot.reading(STATUS, "SOC")
    assert (soc.value, soc.quality) == (102, Quality.OUT_OF_RANGE)
    assert snapshot.reading(STATUS, "PackVoltage").value == pytest.approx(655.35)
    assert snapshot.reading(STATUS, "CellOvervoltage").quality is Quality.GOOD
    wheel = codec.by_name["ARD2_SteeringWheel"].decode(bytes([0, 0, 0xFF, 0xFF, 0xFE, 0xFF, 0, 0]))
    store.put("ARD2_SteeringWheel", wheel, 0)
    snapshot = store.snapshot(0)
    assert snapshot.reading("ARD2_SteeringWheel", "WheelSpeedFL").quality is Quality.SATURATED
    assert snapshot.reading("ARD2_SteeringWheel", "WheelSpeedFR").quality is Quality.GOOD


def test_the_newest_stamp_wins_and_an_older_frame_is_counted(store, put):
    put(100 * MS, SOC=80)
    put(99 * MS, SOC=20)
    assert store.out_of_order == 1
    latest = store.snapshot(100 * MS).latest(STATUS)
    assert latest is not None
    assert (latest.frame_count, latest.arrival_ns) == (1, 100 * MS)
    put(100 * MS, SOC=30)
    assert store.out_of_order == 1, "an equal stamp is not older"
    assert store.snapshot(100 * MS).reading(STATUS, "SOC").value == 30


def test_frames_and_marked_frames_are_counted(store, put, codec):
    put(0, SOC=80)
    store.put(STATUS, codec.by_name[STATUS].decode(b"\xff" * 8), 1)
    put(2, SOC=80)
    latest = store.snapshot(2).latest(STATUS)
    assert latest is not None
    assert (latest.frame_count, latest.marked_count) == (3, 1)


def test_the_observed_period_follows_the_traffic(store, put):
    put(0)
    assert store.snapshot(0).latest(STATUS).period_ns is None
    put(500 * MS)
    assert store.snapshot(0).latest(STATUS).period_ns == 500 * MS
    put(1008 * MS)
    assert store.snapshot(0).latest(STATUS).period_ns == 501 * MS
    for index in range(1, 60):
        put(1008 * MS + index * 100 * MS)
    assert store.snapshot(0).latest(STATUS).period_ns == pytest.approx(100 * MS, rel=0.01)


def test_a_code_has_the_protocols_name_and_a_reserved_one_has_none(store):
    snapshot = store.snapshot(0)
    assert snapshot.code_name(STATUS, "CellUndervoltage", 2) == "level2"
    assert snapshot.code_name("PCU1_Status1", "VoltageLevel", 7) is None


def test_a_name_that_the_protocol_does_not_have_is_an_error(store):
    with pytest.raises(KeyError, match="BMS_Status has no signal Soc"):
        store.snapshot(0).reading(STATUS, "Soc")
