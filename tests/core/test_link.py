"""What error frames say of the bus; the bytes are those of include/uapi/linux/can/error.h."""

import pytest

from vcu_gateway.core.codec import Codec
from vcu_gateway.core.j1939 import Frame
from vcu_gateway.core.link import (
    ERROR_CLASSES,
    Carrier,
    LinkMonitor,
    LinkState,
    LinkStatus,
    PassiveTime,
    after_error_frame,
    with_carrier,
)
from vcu_gateway.core.receive import Receiver

CONTROLLER, BUS_OFF, RESTARTED, LOST_ARBITRATION = 0x004, 0x040, 0x100, 0x002
UP, WARNING, PASSIVE, OFF = LinkState.UP, LinkState.WARNING, LinkState.PASSIVE, LinkState.BUS_OFF


def controller_byte(bits: int) -> bytes:
    return bytes([0, bits, 0, 0, 0, 0, 0, 0])


@pytest.mark.parametrize("before", [UP, WARNING, PASSIVE])
@pytest.mark.parametrize(
    ("bits", "after"),
    [
        (0x04, WARNING),  # receive warning
        (0x08, WARNING),  # transmit warning
        (0x10, PASSIVE),  # receive passive
        (0x20, PASSIVE),  # transmit passive
        (0x40, UP),  # error active again
        (0x18, PASSIVE),  # the worse of two
        (0x50, PASSIVE),
        (0x44, WARNING),
        (0x01, None),  # receive overflow: frames are lost, the bus is not
        (0x02, None),
        (0x00, None),
    ],
)
def test_the_controllers_word_moves_the_state(before, bits, after):
    link = after_error_frame(LinkStatus(before, 3), CONTROLLER, controller_byte(bits), 9)
    assert link.state is (after or before)
    assert link.since_ns == (3 if link.state is before else 9)


@pytest.mark.parametrize("before", [UP, WARNING, PASSIVE])
def test_bus_off_is_believed_whatever_else_the_frame_says(before):
    for can_id in (BUS_OFF, BUS_OFF | CONTROLLER, BUS_OFF | RESTARTED):
        assert after_error_frame(
            LinkStatus(before, 3), can_id, controller_byte(0x40), 9
        ) == LinkStatus(OFF, 9)


@pytest.mark.parametrize("bits", [0x04, 0x08, 0x10, 0x20, 0x3C, 0x01, 0x00])
def test_counters_do_not_end_bus_off(bits):
    off = LinkStatus(OFF, 3)
    assert after_error_frame(off, CONTROLLER, controller_byte(bits), 9) == off


def test_a_restart_or_the_word_active_ends_bus_off():
    assert after_error_frame(LinkStatus(OFF, 3), RESTARTED, bytes(8), 9) == LinkStatus(UP, 9)
    assert after_error_frame(
        LinkStatus(OFF, 3), CONTROLLER, controller_byte(0x40), 9
    ) == LinkStatus(UP, 9)


@pytest.mark.parametrize(
    ("can_id", "data"),
    [
        (0, bytes(8)),
        (LOST_ARBITRATION, controller_byte(0xFF)),
        (CONTROLLER, b""),
        (CONTROLLER, b"\xff"),  # the byte that says it is not there
    ],
)
def test_an_error_frame_that_says_nothing_of_the_state_changes_nothing(can_id, data):
    link = LinkStatus(PASSIVE, 3)
    assert after_error_frame(link, can_id, data, 9) is link


def test_the_time_in_a_state_counts_from_its_beginning():
    link = LinkStatus(UP, 0)
    for at_ns in (10, 20, 30):
        link = after_error_frame(link, CONTROLLER, controller_byte(0x10), at_ns)
    assert link == LinkStatus(PASSIVE, 10)


def test_only_the_classes_that_can_move_the_link_are_asked_of_the_kernel():
    assert ERROR_CLASSES == CONTROLLER | BUS_OFF | RESTARTED
    for bit in range(29):
        classes = 1 << bit
        moved = any(
            after_error_frame(LinkStatus(before, 3), classes, controller_byte(bits), 9).state
            is not before
            for before in (UP, OFF)
            for bits in (0, 0x10, 0x40)
        )
        assert moved == bool(classes & ERROR_CLASSES), hex(classes)


# The carrier.


@pytest.mark.parametrize("told", [UP, WARNING, PASSIVE])
def test_without_a_carrier_the_bus_is_off_whatever_error_frames_told(told):
    assert with_carrier(LinkStatus(told, 3), Carrier(False, 7)) == LinkStatus(OFF, 7)
    assert with_carrier(LinkStatus(told, 3), Carrier(True, 7)) == LinkStatus(told, 3)
    assert with_carrier(LinkStatus(told, 3), None) == LinkStatus(told, 3)


def test_a_bus_off_that_error_frames_told_keeps_its_beginning_without_a_carrier():
    assert with_carrier(LinkStatus(OFF, 3), Carrier(False, 7)) == LinkStatus(OFF, 3)
    assert with_carrier(LinkStatus(OFF, 3), None) == LinkStatus(OFF, 3)


def test_a_carrier_that_came_back_after_it_ends_a_bus_off():
    assert with_carrier(LinkStatus(OFF, 7), Carrier(True, 8)) == LinkStatus(UP, 8)
    assert with_carrier(LinkStatus(OFF, 7), Carrier(True, 7)) == LinkStatus(OFF, 7)
    assert with_carrier(LinkStatus(OFF, 7), Carrier(True, 3)) == LinkStatus(OFF, 7), (
        "older than the bus-off"
    )


# The monitor of error frames, carrier, opening and loss.


@pytest.fixture
def monitor() -> LinkMonitor:
    return LinkMonitor(100)


def test_a_fresh_book_says_up(monitor):
    monitor.begin_tick()
    assert monitor.link == LinkStatus(UP, 100)


def test_error_frames_and_carrier_are_held_together(monitor):
    monitor.take_error_frame(CONTROLLER, controller_byte(0x04), 110)
    assert monitor.link == LinkStatus(WARNING, 110)
    monitor.change_carrier(Carrier(False, 120))
    assert monitor.link == LinkStatus(OFF, 120)
    monitor.change_carrier(Carrier(True, 130))
    assert monitor.link == LinkStatus(WARNING, 110)


def test_an_opening_ends_what_was_said_before_it_and_nothing_after_it(monitor):
    monitor.take_error_frame(BUS_OFF, bytes(8), 110)
    monitor.change_carrier(Carrier(False, 120))
    monitor.open(LinkStatus(UP, 200))
    assert monitor.link == LinkStatus(UP, 200)
    monitor.take_error_frame(CONTROLLER, controller_byte(0x10), 210)
    assert monitor.link == LinkStatus(PASSIVE, 210), "the bus-off before it is over"
    monitor.open(LinkStatus(UP, 205))
    assert monitor.link == LinkStatus(PASSIVE, 210), "reported after that opening"
    monitor.open(LinkStatus(WARNING, 210))
    assert monitor.link == LinkStatus(PASSIVE, 210)


def test_an_opening_can_begin_in_a_bad_state(monitor):
    monitor.open(LinkStatus(PASSIVE, 200), Carrier(True, 200))
    assert monitor.link == LinkStatus(PASSIVE, 200)
    monitor.open(LinkStatus(UP, 300), Carrier(False, 300))
    assert monitor.link == LinkStatus(OFF, 300)


def test_a_state_that_is_told_again_after_an_opening_counts_from_then(monitor):
    monitor.take_error_frame(CONTROLLER, controller_byte(0x10), 110)
    monitor.open(LinkStatus(UP, 200))
    monitor.take_error_frame(CONTROLLER, controller_byte(0x10), 250)
    assert monitor.link == LinkStatus(PASSIVE, 250)


def test_a_bus_off_that_came_and_went_between_two_ticks_counts_in_one_of_them(monitor):
    monitor.begin_tick()
    monitor.take_error_frame(BUS_OFF, bytes(8), 110)
    monitor.take_error_frame(RESTARTED, bytes(8), 120)
    assert monitor.link == LinkStatus(UP, 120)
    monitor.begin_tick()
    assert monitor.link == LinkStatus(OFF, 110)
    monitor.begin_tick()
    assert monitor.link == LinkStatus(UP, 120)


def test_a_bus_off_that_a_tick_has_seen_is_over_with_the_restart(monitor):
    monitor.take_error_frame(BUS_OFF, bytes(8), 110)
    monitor.begin_tick()
    assert monitor.link == LinkStatus(OFF, 110)
    monitor.take_error_frame(RESTARTED, bytes(8), 120)
    monitor.begin_tick()
    assert monitor.link == LinkStatus(UP, 120)


def test_bus_off_told_twice_is_one_bus_off(monitor):
    monitor.take_error_frame(BUS_OFF, bytes(8), 110)
    monitor.begin_tick()
    monitor.take_error_frame(BUS_OFF, bytes(8), 115)
    monitor.take_error_frame(RESTARTED, bytes(8), 120)
    monitor.begin_tick()
    assert monitor.link == LinkStatus(UP, 120)


def test_the_last_of_several_bus_offs_between_two_ticks_is_told(monitor):
    for at_ns in (110, 130):
        monitor.take_error_frame(BUS_OFF, bytes(8), at_ns)
        monitor.take_error_frame(RESTARTED, bytes(8), at_ns + 10)
    monitor.begin_tick()
    assert monitor.link == LinkStatus(OFF, 130)


def test_a_new_bus_off_is_told_before_one_that_was_missed(monitor):
    monitor.take_error_frame(BUS_OFF, bytes(8), 110)
    monitor.take_error_frame(RESTARTED, bytes(8), 120)
    monitor.begin_tick()
    monitor.take_error_frame(BUS_OFF, bytes(8), 130)
    assert monitor.link == LinkStatus(OFF, 130)


def test_the_receiver_enters_error_frames_and_nothing_else(codec: Codec):
    receiver = Receiver(codec, {}, 0)
    receiver.receive(Frame(BUS_OFF, bytes(8), 9, extended=False))
    assert receiver.monitor.link == LinkStatus(UP, 0)
    receiver.receive(Frame(BUS_OFF, bytes(8), 10, error=True))
    assert receiver.monitor.link == LinkStatus(OFF, 10)


def test_a_loss_counts_at_once(monitor):
    monitor.lose(110)
    assert monitor.link == LinkStatus(LinkState.LOST, 110)


def test_a_lost_link_is_lost_since_the_first_report_until_it_is_opened(monitor):
    monitor.lose(110)
    monitor.lose(120)
    monitor.take_error_frame(BUS_OFF, bytes(8), 130)
    monitor.begin_tick()
    assert monitor.link == LinkStatus(LinkState.LOST, 110)
    monitor.open(LinkStatus(UP, 200))
    monitor.begin_tick()
    assert monitor.link == LinkStatus(UP, 200)


def test_an_opening_begins_the_recent_passive_time_again(monitor):
    assert monitor.recent_passive_ns(900) == 0
    monitor.take_error_frame(CONTROLLER, controller_byte(0x10), 1000)
    monitor.take_error_frame(CONTROLLER, controller_byte(0x40), 1500)
    assert monitor.recent_passive_ns(1600) == 500
    monitor.open(LinkStatus(UP, 1700))
    assert monitor.recent_passive_ns(1800) == 0


# Error-passive, in all.


def test_passive_time_gathers_over_interruptions(monitor):
    for at_ns in (1000, 2000):
        monitor.take_error_frame(CONTROLLER, controller_byte(0x10), at_ns)
        assert monitor.passive_ns(at_ns + 400) == (at_ns == 2000) * 500 + 400
        monitor.take_error_frame(CONTROLLER, controller_byte(0x40), at_ns + 500)
    assert monitor.passive_ns(9000) == 1000


def test_an_error_frame_that_says_passive_again_changes_nothing(monitor):
    for at_ns in (1000, 1100, 1200):
        monitor.take_error_frame(CONTROLLER, controller_byte(0x20), at_ns)
    assert monitor.passive_ns(1300) == 300


def test_a_stamp_ahead_of_the_tick_is_no_passive_time_yet(monitor):
    monitor.take_error_frame(CONTROLLER, controller_byte(0x20), 1000)
    assert monitor.passive_ns(999) == 0


def test_an_end_of_the_passive_state_stamped_before_its_beginning_gathers_nothing(monitor):
    monitor.take_error_frame(CONTROLLER, controller_byte(0x20), 1000)
    monitor.take_error_frame(CONTROLLER, controller_byte(0x40), 900)
    assert monitor.passive_ns(2000) == 0


def test_an_interface_opened_in_the_passive_state_gathers_from_then(monitor):
    monitor.open(LinkStatus(PASSIVE, 500))
    assert monitor.passive_ns(700) == 200
    monitor.take_error_frame(CONTROLLER, controller_byte(0x40), 800)
    assert monitor.passive_ns(900) == 300


@pytest.mark.parametrize(("at_s", "within_s"), [(4.9, 1), (5.0, 1), (6.0, 0.0), (5.5, 0.5)])
def test_of_the_passive_time_only_that_of_the_last_5_s_counts(at_s, within_s):
    """Passive for the first second, looked at every 50 ms."""
    passive, seconds = PassiveTime(), 10**9
    for tick in range(round(at_s * 20) + 1):
        now_ns = tick * seconds // 20
        found_ns = passive.within(min(now_ns, seconds), now_ns)
    assert found_ns == within_s * seconds


def test_passive_time_is_never_told_too_short_where_ticks_are_far_apart():
    passive = PassiveTime()
    assert passive.within(0, 0) == 0
    assert passive.within(900, 3_000_000_000) == 900
    assert passive.within(1000, 7_000_000_000) == 1000
    assert passive.within(1000, 12_000_000_000) == 0


@pytest.mark.parametrize(("after_ns", "told_ns"), [(5 * 10**9 - 1, 100), (5 * 10**9, 0)])
def test_passive_time_counts_until_the_tick_after_it_is_5_s_old(after_ns, told_ns):
    passive = PassiveTime()
    passive.within(0, 0)
    passive.within(100, 10)
    assert passive.within(100, 10 + after_ns) == told_ns
