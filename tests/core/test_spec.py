"""Looking up what the protocol holds."""

import pytest

from vcu_gateway.core.spec import SignalSpec


def test_messages_and_signals_are_found_by_name(protocol):
    message = protocol.message("BMS_Status")
    assert message.name == "BMS_Status"
    assert message.signal("SOC") is message.signals[message.signal_names.index("SOC")]
    with pytest.raises(KeyError, match="the protocol has no message BMS_Statue"):
        protocol.message("BMS_Statue")
    with pytest.raises(KeyError, match="BMS_Status has no signal soc"):
        message.signal("soc")


def test_messages_are_found_by_who_sends_and_receives_them(protocol):
    assert [m.name for m in protocol.sent_by("VCU")] == ["VCU_PCU1_Command", "VCU_PCU2_Command"]
    assert [m.name for m in protocol.received_by("PCU2")] == ["VCU_PCU2_Command"]
    received = {m.name for m in protocol.received_by("VCU")}
    assert received == {m.name for m in protocol.messages if m.sender != "VCU"}
    assert protocol.sent_by("GHOST") == ()


@pytest.mark.parametrize(
    ("signal", "lowest", "highest"),
    [
        (SignalSpec("S", 0, 1, 0, 1), 0, 1),
        (SignalSpec("S", 0, 8, 0, 255), 0, 255),
        (SignalSpec("S", 0, 8, 0, 0, signed=True), -128, 127),
        (SignalSpec("S", 0, 64, 0, 0), 0, 2**64 - 1),
        (SignalSpec("S", 0, 64, 0, 0, signed=True), -(2**63), 2**63 - 1),
    ],
)
def test_the_bits_hold_so_many_codes(signal, lowest, highest):
    assert (signal.raw_lowest, signal.raw_highest) == (lowest, highest)


@pytest.mark.parametrize(
    ("signal", "minimum", "maximum"),
    [
        (SignalSpec("S", 0, 16, 0, 65.535, factor=0.001), 0, 65535),
        (SignalSpec("S", 0, 16, 0, 65.5349, factor=0.001), 0, 65534),
        (SignalSpec("S", 0, 16, -1e9, 1e9), 0, 65535),
        (SignalSpec("S", 0, 8, -10, 0, factor=-2.0), 0, 5),
        (SignalSpec("S", 0, 8, -40, 60, offset=-40), 0, 100),
        (SignalSpec("S", 0, 8, 0.5, 2.5, signed=True), 1, 2),
    ],
)
def test_the_range_holds_so_many_codes(signal, minimum, maximum):
    assert (signal.raw_minimum, signal.raw_maximum) == (minimum, maximum)


@pytest.mark.parametrize(
    ("signal", "positions"),
    [
        (SignalSpec("S", 4, 6, 0, 0), (4, 5, 6, 7, 8, 9)),
        (SignalSpec("S", 3, 6, 0, 0, "big"), (14, 15, 0, 1, 2, 3)),
        (SignalSpec("S", 7, 16, 0, 0, "big"), (*range(8, 16), *range(8))),
        (SignalSpec("S", 5, 2, 0, 0, "big"), (4, 5)),
    ],
)
def test_the_bits_lie_where_a_dbc_puts_them(signal, positions):
    assert signal.bit_positions() == positions
