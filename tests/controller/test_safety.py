"""The reactions that tests/vcan measures, by the same tests and bounds, on real controllers."""

from tests.vcan.test_safety import (  # noqa: F401 - the same tests, on this bus
    begin,
    test_a_gateway_that_was_stopped_for_a_second_goes_on_with_zero_torque_and_no_burst,
    test_another_sender_of_a_command_stops_both_motors_and_latches,
    test_silence_stops_both_motors_within_its_deadline_and_one_tick,
    test_undervoltage_stops_both_motors_within_one_tick_and_a_cut_cause_cuts_the_power,
    within,
)
