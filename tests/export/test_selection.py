"""Selection: patterns of signals."""

import pytest

from vcu_gateway.export.source import Selection


@pytest.mark.parametrize(
    ("pattern", "wanted"),
    [
        ("BMS_Status.SOC", True),
        ("bms_status.soc", True),
        ("SOC", True),
        ("BMS_Status", True),
        ("BMS_*", True),
        ("*.S?C", True),
        ("SO", False),
        ("PCU*", False),
        ("BMS_Status.Pack*", False),
    ],
)
def test_a_pattern_names_a_signal_a_message_or_both(pattern, wanted):
    selection = Selection((pattern,))
    assert selection.wants("BMS_Status", "SOC") is wanted
    assert selection.unused == (() if wanted else (pattern,))


def test_without_a_pattern_every_signal_is_wanted():
    assert Selection().wants("BMS_Status", "SOC")
    assert Selection().unused == ()


def test_several_patterns_add_up_and_each_is_known_to_be_used():
    selection = Selection(("SOC", "BMS_*", "none"))
    assert selection.wants("BMS_Status", "SOC")
    assert selection.unused == ("none",)
