"""What is asked, as the gateway takes it, and what asks for no motion."""

import math

import pytest
from pydantic import BaseModel

from vcu_gateway.api import methods
from vcu_gateway.client import demand

ZERO = {"throttle_pct": 0.0, "throttle_track2_pct": 0.0, "brake_pct": 0.0}


class LikeNumpy:
    """A number of another library."""

    def __float__(self) -> float:
        return 12.5


def test_values_without_a_name_are_for_both_controllers():
    assert demand.request_values({"throttle_pct": 20}) == {"values": {"throttle_pct": 20.0}}


def test_values_can_differ_between_the_controllers():
    body = demand.request_values({"PCU1": {"throttle_pct": 1}, "PCU2": {"throttle_pct": 2}})
    assert body == {"controllers": {"PCU1": {"throttle_pct": 1.0}, "PCU2": {"throttle_pct": 2.0}}}


def test_asking_for_nothing_is_a_demand_at_its_defaults():
    assert demand.request_values({}) == {"values": {}}


def test_values_beside_controllers_are_left_for_the_gateway_to_refuse():
    assert set(demand.request_values({"PCU1": {}, "brake_pct": 1})) == {"values", "controllers"}


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 10**400])
def test_a_number_that_is_not_finite_is_refused_here_by_its_name(value):
    with pytest.raises(ValueError, match="brake_pct"):
        demand.request_values({"brake_pct": value})
    with pytest.raises(ValueError, match="brake_pct"):
        demand.request_values({"PCU1": {"brake_pct": value}, "PCU2": {}})


def test_a_value_of_the_wrong_kind_is_refused_before_anything_is_kept():
    with pytest.raises(TypeError):
        demand.request_values({"throttle_pct": [20]})


def test_numbers_of_other_libraries_are_taken():
    assert demand.request_values({"throttle_pct": LikeNumpy()}) == {
        "values": {"throttle_pct": 12.5}
    }


def test_words_switches_and_none_pass_as_they_are():
    given = {"power_mode": "turbo", "motor_reverse": True, "speed_limit_rpm": None}
    assert demand.request_values(given) == {"values": given}


def test_a_number_out_of_range_is_left_for_the_gateway_to_judge():
    assert demand.request_values({"throttle_pct": 900}) == {"values": {"throttle_pct": 900.0}}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ({"throttle_pct": 20, "brake_pct": 5, "regen_brake": True}, {}),
        ({"throttle_pct": 20, "motor_reverse": True}, {"motor_reverse": True}),
        ({"throttle_pct": 20, "motor_reverse": "yes"}, {}),
    ],
)
def test_no_motion_keeps_the_direction_and_nothing_else(before, after):
    still = demand.without_motion(demand.request_values(before))
    assert still == {"values": {**ZERO, **after}}


def test_no_motion_keeps_each_controllers_direction():
    body = demand.request_values({"PCU1": {"throttle_pct": 9, "motor_reverse": True}, "PCU2": {}})
    expected = {"PCU1": {**ZERO, "motor_reverse": True}, "PCU2": ZERO}
    assert demand.without_motion(body) == {"controllers": expected}


def test_no_motion_is_asked_of_both_controllers_where_one_was_forgotten():
    still = demand.without_motion(demand.request_values({"PCU2": {"throttle_pct": 9}}))
    assert set(still["controllers"]) == {"PCU1", "PCU2"}


def test_the_values_are_those_of_the_contract():
    model: type[BaseModel] = methods.ControllerParams
    assert set(demand.ControllerValues.__annotations__) == set(model.model_fields)
    assert set(demand.DemandValues.__annotations__) - set(model.model_fields) == set(
        demand.CONTROLLERS
    )
