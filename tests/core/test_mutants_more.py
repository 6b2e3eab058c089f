"""What the mutation run found that no other test would have noticed."""

import pytest

from vcu_gateway.core.causes import Causes, Effect, Finding
from vcu_gateway.core.demand import ControllerDemand, Demand
from vcu_gateway.core.gateway import Gateway
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.schedule import LATENESS_BOUNDS_NS, Schedule, Tick, lateness_bin
from vcu_gateway.core.settings import Settings
from vcu_gateway.core.state import FUTURE_TOLERANCE_NS, Quality, Snapshot, Store, mark
from vcu_gateway.core.supervisor import FaultClass, Mode

MS = 1_000_000
STATUS = "BMS_Status"
WHEEL = "ARD2_SteeringWheel"


@pytest.fixture
def store(protocol):
    received = protocol.received_by("VCU")
    return Store(received, {message.name: 1600 * MS for message in received})


@pytest.fixture
def put(codec, store):
    def put(data, at_ns=0, message=STATUS):
        return store.put(message, codec.by_name[message].decode(bytes(data)), at_ns)

    return put


def repeats(store):
    return store.snapshot(0).latest(STATUS).life_repeats


def status(life, soc=80):
    return (0, 0, 0, 0, soc, 0, 0, life << 7)


def test_each_frame_whose_life_signal_stood_still_is_counted(store, put):
    found = []
    for life in (0, 1, 1, 1, 1, 0, 0, 1):
        put(status(life))
        found.append(repeats(store))
    assert found == [0, 0, 1, 2, 3, 0, 1, 0]


def test_a_frame_that_is_not_taken_does_not_count_for_the_life_signal(store, put):
    put(status(0), 100)
    put(status(0), 99)
    assert repeats(store) == 0
    assert store.out_of_order == 1


def test_a_message_without_a_life_signal_never_stands_still(store, put):
    for _ in range(3):
        put(bytes(8), message="PCU1_Status2")
    assert store.snapshot(0).latest("PCU1_Status2").life_repeats == 0


def test_one_nanosecond_is_out_of_order(store, put):
    put(status(0), 100)
    assert not put(status(1), 99)


def test_the_codes_that_are_out_of_range_are_named(store, put):
    snapshot = store.snapshot(0)
    assert snapshot.marked(STATUS) == ()
    put(status(0))
    assert store.snapshot(0).marked(STATUS) == ()
    put((0xFF, 0xFF, 0, 0, 101, 0, 0, 0))
    assert store.snapshot(0).marked(STATUS) == (("PackVoltage", 0xFFFF), ("SOC", 101))
    put((0, 0, 0, 0, 0xFF, 0xFF, 0, 0), message=WHEEL)
    assert store.snapshot(0).marked(WHEEL) == (("WheelSpeedFR", 0xFFFF),)


def test_each_signal_is_marked_by_its_own_bit(codec):
    decoded = codec.by_name[WHEEL].decode(bytes((0xFF, 0xFF, 0xFF, 0xFF, 1, 0, 0, 0)))
    signals = codec.by_name[WHEEL].spec.signals
    assert [mark(decoded, i, signal) for i, signal in enumerate(signals)] == [
        Quality.OUT_OF_RANGE,
        Quality.SATURATED,
        Quality.GOOD,
    ]


def test_a_stamp_may_be_twenty_milliseconds_ahead(store, put):
    assert FUTURE_TOLERANCE_NS == 20 * MS
    put(status(0), 20 * MS)
    assert not store.snapshot(0).stale(STATUS)
    assert store.snapshot(-1).stale(STATUS)


def test_a_snapshot_reads_only_messages_of_the_protocol(store):
    snapshot = store.snapshot(0)
    assert isinstance(snapshot, Snapshot)
    with pytest.raises(KeyError):
        snapshot.readings("Unknown")


# The schedule.


def test_the_bins_of_the_lateness_histogram():
    microseconds = (50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 25_000)
    assert tuple(1_000 * bound for bound in microseconds) == LATENESS_BOUNDS_NS
    assert Schedule(0, 1).lateness_counts == [0] * 10


@pytest.mark.parametrize("bound", range(len(LATENESS_BOUNDS_NS)))
def test_a_bound_belongs_to_its_own_bin(bound):
    assert lateness_bin(LATENESS_BOUNDS_NS[bound]) == bound
    assert lateness_bin(LATENESS_BOUNDS_NS[bound] + 1) == bound + 1


def test_the_shortest_period_is_one_nanosecond():
    assert Schedule(0, 1).period_ns == 1
    for period_ns in (0, -1):
        with pytest.raises(ValueError, match=f"period_ns must be above 0, not {period_ns}"):
            Schedule(0, period_ns)


def test_one_nanosecond_early_is_early_and_counts_nothing():
    schedule = Schedule(100, 50 * MS)
    assert schedule.due(99) is None
    assert (schedule.ticks, schedule.skipped, schedule.next_index) == (0, 0, 0)
    tick = schedule.due(100)
    assert tick == Tick(index=0, deadline_ns=100, lateness_ns=0, skipped=0)


# The gateway.


def test_neither_arm_nor_reset_is_granted_before_the_listening_is_over(codec):
    """A fault may clear sooner than the listening ends; nothing was sent then yet."""
    gateway = Gateway(codec, Settings(listen_before_talk_ms=1000, clear_hold_ms=0), 0)
    gateway.receive(Frame(0x0008A7D0, bytes(8), 0))
    assert gateway.tick(0).mode is Mode.FAULT
    for request in (
        gateway.requests.reset(FaultClass.SERVICE, 50 * MS),
        gateway.requests.arm(50 * MS),
    ):
        assert not request.granted
        assert request.sentence == "listening for another sender of our frames"
    assert gateway.tick(999 * MS).frames == ()
    assert len(gateway.tick(1000 * MS).frames) == 2


@pytest.mark.parametrize("length", [0, 7, 9])
def test_a_foreign_command_of_any_length_is_a_foreign_sender(codec, length):
    gateway = Gateway(codec, Settings(), 0)
    gateway.receive(Frame(0x0008A8D0, bytes(length), 0))
    assert gateway.receiver.foreign_commands == {"PCU1": 0, "PCU2": 1}
    assert gateway.tick(0).mode is Mode.FAULT


@pytest.mark.parametrize(("code", "after"), [(2, 0), (1, 0), (0, 0)])
def test_an_overcharged_cell_keeps_regeneration_off_whatever_comes_after_it(code, after):
    causes = Causes()

    def tell(raw, at_ns):
        effect = Effect.REGEN_OFF if raw >= 2 else Effect.REGEN_LIMIT
        found = Finding("code", "CellOvervoltage", effect, until_restart=raw == 3)
        causes.update([found] if raw else [], 1000, at_ns)

    for at_ns, raw in ((0, 3), (10, code), (20_000, after), (40_000, after)):
        tell(raw, at_ns)
    assert Effect.REGEN_OFF in causes.effects()


def test_a_new_demand_does_not_continue_a_drive_whose_demand_expired_between_two_ticks(codec):
    gateway = Gateway(codec, Settings(), 0)
    both = dict.fromkeys(("PCU1", "PCU2"), ControllerDemand())
    gateway.requests.offer(Demand("driver", 1, 10, both), 0)
    gateway.supervisor.mode = Mode.ACTIVE
    gateway.requests.offer(Demand("driver", 2, 10, both), 10 * MS)
    assert gateway.supervisor.mode is Mode.ACTIVE
    gateway.requests.offer(Demand("driver", 3, 10, both), 20 * MS + 1)
    assert gateway.supervisor.mode is Mode.STANDBY


def test_the_latest_code_is_told_however_old_it_is(store, put):
    assert store.snapshot(0).codes(STATUS, ("SOC", "PackVoltage")) == []
    put(status(0, soc=80))
    put(status(1, soc=101))
    for now_ns in (0, 10**15):
        assert store.snapshot(now_ns).codes(STATUS, ("SOC", "InternalFault")) == [(101, 0)]
    with pytest.raises(KeyError, match="Soc"):
        store.snapshot(0).codes(STATUS, ("Soc", "SOC"))
