"""Changes of the link, taken in tick by tick, and the events they become."""

from collections import deque
from typing import Any, cast

import pytest

from tests.core.simulated_drive import Drive, active
from vcu_gateway.bus.connection import BusConnection, BusSettings
from vcu_gateway.bus.interface import Interface
from vcu_gateway.bus.netlink import InterfaceDetails
from vcu_gateway.bus.reconnect import CarrierChanged, LinkLost, LinkOpened, Reconnector, Unavailable
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import LinkState
from vcu_gateway.core.supervisor import Mode
from vcu_gateway.daemon.events import EventLog, LinkEvents

MS = 1_000_000
BUS_OFF, RESTARTED, CONTROLLER = 0x040, 0x100, 0x004
CAN0 = Interface(number=3, is_can=True, up=True, carrier=True, tx_queue_frames=4)


class FakeReconnector:
    def __init__(self) -> None:
        self.changes: deque = deque()

    def check(self) -> None:
        pass


class LinkRig:
    """A driving vehicle, whose link events are handled tick by tick."""

    def __init__(self) -> None:
        self.drive: Drive = active()
        self.reconnector = FakeReconnector()
        self.event_log = EventLog()
        settings = BusSettings(
            "socketcan", "can0", receive_buffer_bytes=1_000_000, bit_rate_bit_s=250_000
        )
        self.connection = BusConnection(settings, (), self.drive.gateway.receive)
        self.starts_of_sending = 0
        self.connection.start_sending = self.start_sending
        self.link_events = LinkEvents(
            self.drive.gateway,
            self.connection,
            cast(Reconnector, self.reconnector),
            self.event_log,
        )

    def start_sending(self) -> None:
        self.starts_of_sending += 1

    def tick(self, times: int = 1) -> Mode:
        for _ in range(times):
            self.link_events.before_tick(self.drive.now_ns)
            self.drive.tick()
            self.link_events.after_tick(self.drive.now_ns)
        return self.drive.mode

    def error(self, can_id: int, bits: int = 0) -> None:
        data = bytes([0, bits, 0, 0, 0, 0, 0, 0])
        self.drive.gateway.receive(Frame(can_id, data, self.drive.now_ns, error=True))

    def opened(self, **changes: Any) -> LinkOpened:
        whole = LinkOpened(self.drive.now_ns, CAN0, InterfaceDetails(), 1_000_000)
        return whole._replace(**changes)

    def emitted(self, name: str) -> list[dict[str, Any]]:
        """Fields of the events of this name."""
        events = [entry.event for entry in self.event_log.latest(999)]
        return [dict(event.fields) for event in events if event.name == name]


@pytest.fixture
def rig() -> LinkRig:
    return LinkRig()


def test_a_loss_latches_even_if_the_link_is_back_before_the_next_tick(rig: LinkRig):
    rig.reconnector.changes += [LinkLost(rig.drive.now_ns, "can0 is down"), rig.opened()]
    assert rig.tick() is Mode.FAULT
    assert rig.drive.gateway.link.state is LinkState.LOST
    assert rig.starts_of_sending == 0, "nothing leaves in the tick that learns of the loss"
    assert rig.tick() is Mode.FAULT
    assert rig.drive.gateway.link.state is LinkState.UP
    assert rig.starts_of_sending == 1
    assert rig.emitted("link_lost") == [{"reason": "can0 is down"}]
    assert rig.emitted("link_open") == [{}]


def test_before_the_first_opening_the_link_is_lost(rig: LinkRig):
    rig.link_events.begin(rig.drive.now_ns)
    assert rig.drive.gateway.link.state is LinkState.LOST


def test_what_keeps_it_from_opening_is_reported(rig: LinkRig):
    rig.reconnector.changes.append(Unavailable("can0 is down; ip link set can0 up"))
    rig.tick()
    assert rig.emitted("link_unavailable") == [{"reason": "can0 is down; ip link set can0 up"}]


def test_a_bus_off_between_two_ticks_latches(rig: LinkRig):
    rig.error(BUS_OFF)
    rig.error(RESTARTED)
    assert rig.tick() is Mode.FAULT
    assert rig.drive.gateway.supervisor.latch.reason == "link bus off: stop"
    rig.tick()
    assert rig.drive.gateway.link.state is LinkState.UP
    assert [one["state"] for one in rig.emitted("link_state")] == ["bus off", "up"]


def test_a_missing_carrier_latches_as_bus_off(rig: LinkRig):
    rig.reconnector.changes.append(CarrierChanged(rig.drive.now_ns, present=False))
    assert rig.tick() is Mode.FAULT
    assert rig.drive.gateway.link.state is LinkState.BUS_OFF
    rig.reconnector.changes.append(CarrierChanged(rig.drive.now_ns, present=True))
    rig.tick()
    assert rig.drive.gateway.link.state is LinkState.UP


def test_the_controllers_state_at_the_opening_counts(rig: LinkRig):
    rig.reconnector.changes.append(rig.opened(details=InterfaceDetails(state=LinkState.PASSIVE)))
    rig.tick(20)
    assert rig.drive.mode is Mode.ACTIVE
    rig.tick(2)
    assert rig.drive.mode is Mode.FAULT, "passive for more than a second"


def test_an_opening_without_a_carrier_is_bus_off(rig: LinkRig):
    rig.reconnector.changes.append(rig.opened(details=InterfaceDetails(carrier=False)))
    assert rig.tick() is Mode.FAULT


def test_a_state_is_reported_when_it_changes_with_the_one_before(rig: LinkRig):
    for bits in (0x08, 0x08, 0x20, 0x40):
        rig.error(CONTROLLER, bits)
        rig.tick(2)
    assert rig.emitted("link_state") == [
        {"state": "error warning", "before": "up"},
        {"state": "error passive", "before": "error warning"},
        {"state": "up", "before": "error passive"},
    ]


def test_a_link_that_flickers_for_an_hour_does_not_fill_the_log(rig: LinkRig):
    told = []
    rig.event_log.emit = told.append  # type: ignore[assignment]  # overheard
    for _ in range(36_000):
        rig.error(CONTROLLER, 0x08)
        rig.link_events.after_tick(rig.drive.now_ns)
        rig.drive.now_ns += 50 * MS
        rig.error(CONTROLLER, 0x40)
        rig.link_events.after_tick(rig.drive.now_ns)
        rig.drive.now_ns += 50 * MS
    assert 1700 <= len(told) <= 1850, "one in 2 s"
    rig.drive.now_ns += 2000 * MS
    rig.error(CONTROLLER, 0x08)
    for _ in range(2):
        rig.link_events.after_tick(rig.drive.now_ns)
        rig.drive.now_ns += 2000 * MS
    assert told[-1].fields["state"] == "error warning", "the last state is told in the end"


def test_after_a_quiet_time_ten_changes_are_reported_as_they_come(rig: LinkRig):
    rig.drive.now_ns += 3_600_000 * MS
    for _ in range(10):
        rig.error(CONTROLLER, 0x08)
        rig.link_events.after_tick(rig.drive.now_ns)
        rig.error(CONTROLLER, 0x40)
        rig.link_events.after_tick(rig.drive.now_ns)
        rig.drive.now_ns += 1
    assert sum(entry.count for entry in rig.event_log.latest(99)) == 10


def test_dropped_frames_are_reported_at_most_every_ten_seconds(rig: LinkRig):
    for _ in range(400):
        rig.connection.counters.dropped += 3
        rig.tick()
    told = [one["frames"] for one in rig.emitted("frames_dropped")]
    assert told == [3, 600]


@pytest.mark.parametrize(
    ("changes", "name", "fields"),
    [
        (
            {"interface": CAN0._replace(tx_queue_frames=5)},
            "tx_queue_long",
            {"frames": 5, "command": "ip link set can0 txqueuelen 4"},
        ),
        (
            {"receive_buffer_bytes": 999_999},
            "receive_buffer_small",
            {
                "asked_bytes": 1_000_000,
                "given_bytes": 999_999,
                "command": "sysctl -w net.core.rmem_max=1000000",
            },
        ),
        (
            {"details": InterfaceDetails(bit_rate_bit_s=500_000)},
            "bit_rate_differs",
            {
                "wanted_bit_s": 250_000,
                "found_bit_s": 500_000,
                "command": "ip link set can0 down && ip link set can0 up type can bitrate 250000",
            },
        ),
        (
            {"details": InterfaceDetails(driver_echoes=False, state=LinkState.UP)},
            "echo_unproven",
            {
                "reason": (
                    "the driver confirms nothing: only the controllers' answers tell that frames"
                    " left"
                )
            },
        ),
    ],
)
def test_what_is_not_as_it_should_be_is_reported_once_with_the_command_that_fixes_it(
    rig: LinkRig, changes, name, fields
):
    for _ in range(3):
        rig.reconnector.changes.append(rig.opened(**changes))
        rig.tick()
    assert rig.emitted(name) == [fields]
    assert sum(entry.count for entry in rig.event_log.latest(99)) == 4, "three openings, this"


@pytest.mark.parametrize(
    "changes",
    [
        {"interface": CAN0._replace(tx_queue_frames=0)},
        {
            "interface": CAN0._replace(tx_queue_frames=1000),
            "details": InterfaceDetails(queue_is_used=False),
        },
        {"receive_buffer_bytes": None},
        {"receive_buffer_bytes": 2_000_000},
        {"details": InterfaceDetails(bit_rate_bit_s=250_000)},
        {"details": InterfaceDetails(driver_echoes=True, state=LinkState.UP)},
        {"details": InterfaceDetails(driver_echoes=False)},  # vcan: nothing can fail to leave
    ],
)
def test_what_is_as_it_should_be_is_not_reported(rig: LinkRig, changes):
    rig.reconnector.changes.append(rig.opened(**changes))
    rig.tick()
    assert [entry.event.name for entry in rig.event_log.latest(99)] == ["link_open"]
