"""Findings of coded signals: kept while their frame is the latest, and no longer."""

import pytest

from tests.core.simulated_drive import CODEC, MS, NOW_NS, PROTOCOL, RECEIVED, data
from vcu_gateway.core.causes import BATTERY_STATUS, CodedSignals
from vcu_gateway.core.state import Store


class Battery:
    """Battery frames in a store, and what their codes find at each tick."""

    def __init__(self) -> None:
        self.coded = CodedSignals()
        self.store = Store(PROTOCOL.received_by("VCU"), dict.fromkeys(RECEIVED, 1100 * MS))
        self.now_ns = NOW_NS

    def receive(self, after_ms: int = 0, **codes: int) -> None:
        decoded = CODEC.by_name[BATTERY_STATUS].decode(data(BATTERY_STATUS, codes))
        self.store.put(BATTERY_STATUS, decoded, self.now_ns + after_ms * MS)

    def tick(self) -> list[str]:
        self.now_ns += 50 * MS
        snapshot = self.store.take(self.now_ns)
        return [str(one) for one in self.coded.findings(snapshot, BATTERY_STATUS)]


OVERTEMPERATURE = "BMS_Status.Overtemperature 1 (level1): alarm"
UNDERTEMPERATURE = "BMS_Status.Undertemperature 1 (level1): regen off"


@pytest.fixture
def battery() -> Battery:
    battery = Battery()
    battery.receive()
    assert battery.tick() == []
    return battery


def test_a_code_is_found_in_every_tick_until_the_next_frame(battery: Battery):
    battery.receive(Overtemperature=1)
    assert [battery.tick() for _ in range(3)] == [[OVERTEMPERATURE]] * 3
    battery.receive(Undertemperature=1)
    assert [battery.tick() for _ in range(3)] == [[UNDERTEMPERATURE]] * 3
    battery.receive()
    assert [battery.tick() for _ in range(3)] == [[]] * 3


def test_of_several_frames_each_code_counts_and_afterwards_the_last_ones(battery: Battery):
    battery.receive(Overtemperature=1)
    battery.receive(1, Undertemperature=1)
    assert sorted(battery.tick()) == [OVERTEMPERATURE, UNDERTEMPERATURE]
    assert battery.tick() == [UNDERTEMPERATURE]


def test_a_frame_out_of_order_counts_once_beside_the_latest(battery: Battery):
    battery.receive(Overtemperature=1)
    assert battery.tick() == [OVERTEMPERATURE]
    battery.receive(-60, Undertemperature=1)
    assert UNDERTEMPERATURE in battery.tick()
    assert battery.tick() == [OVERTEMPERATURE]


def test_nothing_is_looked_up_again_while_no_frame_comes(battery: Battery):
    battery.receive(Overtemperature=1)
    battery.tick()
    found = [battery.coded.findings(battery.store.take(battery.now_ns), BATTERY_STATUS)
             for _ in range(2)]  # fmt: skip
    assert found[0] is found[1]


def test_before_the_first_frame_nothing_is_found():
    assert Battery().tick() == []
