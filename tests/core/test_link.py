"""What error frames say of the bus; the bytes are those of include/uapi/linux/can/error.h."""

import pytest

from vcu_gateway.core.link import Link, LinkState, after_error_frame

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
    link = after_error_frame(Link(before, 3), CONTROLLER, controller_byte(bits), 9)
    assert link.state is (after or before)
    assert link.since_ns == (3 if link.state is before else 9)


@pytest.mark.parametrize("before", [UP, WARNING, PASSIVE])
def test_bus_off_is_believed_whatever_else_the_frame_says(before):
    for can_id in (BUS_OFF, BUS_OFF | CONTROLLER, BUS_OFF | RESTARTED):
        assert after_error_frame(Link(before, 3), can_id, controller_byte(0x40), 9) == Link(OFF, 9)


@pytest.mark.parametrize("bits", [0x04, 0x08, 0x10, 0x20, 0x3C, 0x01, 0x00])
def test_counters_do_not_end_bus_off(bits):
    off = Link(OFF, 3)
    assert after_error_frame(off, CONTROLLER, controller_byte(bits), 9) == off


def test_a_restart_or_the_word_active_ends_bus_off():
    assert after_error_frame(Link(OFF, 3), RESTARTED, bytes(8), 9) == Link(UP, 9)
    assert after_error_frame(Link(OFF, 3), CONTROLLER, controller_byte(0x40), 9) == Link(UP, 9)


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
    link = Link(PASSIVE, 3)
    assert after_error_frame(link, can_id, data, 9) is link


def test_the_time_in_a_state_counts_from_its_beginning():
    link = Link(UP, 0)
    for at_ns in (10, 20, 30):
        link = after_error_frame(link, CONTROLLER, controller_byte(0x10), at_ns)
    assert link == Link(PASSIVE, 10)
