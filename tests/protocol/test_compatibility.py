"""A DBC of one's own is held against the protocol that the safety rules were written for."""

from dataclasses import replace
from typing import Any

import pytest

from vcu_gateway.core.spec import MessageSpec, ProtocolSpec
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.protocol.dbc import differences

PROTOCOL = dbc.load(packaged("vcu.dbc"))
BATTERY = PROTOCOL.message("BMS_Status")
SOC = next(signal for signal in BATTERY.signals if signal.name == "SOC")


def with_battery(*messages: MessageSpec) -> ProtocolSpec:
    """The packaged protocol with these messages instead of the battery's."""
    others = [message for message in PROTOCOL.messages if message is not BATTERY]
    return replace(PROTOCOL, messages=(*others, *messages))


def of_the_battery(**changed: Any) -> list[str]:
    return list(differences(with_battery(replace(BATTERY, **changed)), PROTOCOL))


def of_the_soc(**changed: Any) -> list[str]:
    signals = tuple(replace(one, **changed) if one is SOC else one for one in BATTERY.signals)
    return of_the_battery(signals=signals)


def test_the_packaged_protocol_agrees_with_itself():
    assert list(differences(PROTOCOL, PROTOCOL)) == []


def test_a_message_that_is_missing_is_named():
    assert list(differences(with_battery(), PROTOCOL)) == [
        "there is no message BMS_Status (0x1808D0F4)"
    ]


def test_a_signal_that_is_missing_is_named():
    rest = tuple(one for one in BATTERY.signals if one is not SOC)
    assert of_the_battery(signals=rest) == ["BMS_Status (0x1808D0F4): there is no signal SOC"]


@pytest.mark.parametrize(
    ("name", "value", "what"),
    [
        ("can_id", 0x1808D0F5, "identifier is 0x1808D0F5, not 0x1808D0F4"),
        ("sender", "PCU1", "sender is PCU1, not BMS"),
        ("period_ms", 499, "period_ms is 499, not 500"),
    ],
)
def test_another_value_of_a_message_is_told_with_the_right_one(name, value, what):
    assert of_the_battery(**{name: value}) == [f"BMS_Status (0x1808D0F4): {what}"]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("start_bit", SOC.start_bit + 1),
        ("length_bits", SOC.length_bits - 1),
        ("byte_order", "another"),
        ("signed", not SOC.signed),
        ("factor", SOC.factor * 2),
        ("offset", SOC.offset + 1),
        ("minimum", SOC.minimum - 1),
        ("maximum", SOC.maximum + 1),
        ("saturated_raw", 1),
    ],
)
def test_another_value_of_a_signal_is_told_with_the_right_one(name, value):
    right = getattr(SOC, name)
    what = f"{name} is {value}, not {right}"
    assert of_the_soc(**{name: value}) == [f"BMS_Status.SOC (0x1808D0F4): {what}"]


def test_what_a_dbc_has_besides_is_no_difference():
    further = replace(BATTERY, name="Further", can_id=0x1808D0F6)
    assert list(differences(with_battery(BATTERY, further), PROTOCOL)) == []
    signals = (*BATTERY.signals, replace(SOC, name="Further"))
    assert of_the_battery(signals=signals) == []
