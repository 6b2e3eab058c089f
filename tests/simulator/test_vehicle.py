"""The vehicle's physics: what a driver would notice."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vcu_gateway.core.commands import Command
from vcu_gateway.core.demand import PowerMode
from vcu_gateway.simulator.motor import order_of
from vcu_gateway.simulator.vehicle import LEFT, RIGHT, STEP_NS, Vehicle

S_NS = 1_000_000_000
COMMAND_PERIOD_NS = 50_000_000
FULL: dict[str, float] = {
    "PowerMode": 2,
    "Throttle": 99.45,
    "SpeedLimit": 12000,
    "PowerLimit": 60000,
    "PowerCut": 0,
}
ZERO_TORQUE: dict[str, float] = {"PowerMode": 3, "SpeedLimit": 12000, "PowerCut": 0}


class Drive:
    """A vehicle with a driver who repeats the same command every 50 ms."""

    def __init__(self, **options: float) -> None:
        self.vehicle = Vehicle(0, **options)
        self.now_ns = 0

    def hold(self, seconds: float, values: dict[str, float]) -> Vehicle:
        for _ in range(round(seconds * S_NS / COMMAND_PERIOD_NS)):
            for controller in (LEFT, RIGHT):
                self.vehicle.command(controller, values, self.now_ns)
            self.now_ns += COMMAND_PERIOD_NS
            self.vehicle.advance(self.now_ns)
        return self.vehicle

    def silence(self, seconds: float) -> Vehicle:
        self.now_ns += round(seconds * S_NS)
        self.vehicle.advance(self.now_ns)
        return self.vehicle


def power_w(vehicle: Vehicle) -> float:
    return vehicle.battery.voltage_v * vehicle.battery.current_a


def test_without_a_command_nothing_moves() -> None:
    vehicle = Drive().silence(5)
    assert vehicle.speed_m_s == 0
    assert all(motor.torque_nm == 0 for motor in vehicle.motors.values())


def test_throttle_accelerates_and_the_motors_turn_with_the_wheels() -> None:
    vehicle = Drive().hold(1, FULL)
    assert vehicle.speed_m_s > 3
    assert vehicle.acceleration_m_s2 > 3
    # 9:1 gear, wheels of 0.28 m radius
    expected_rpm = vehicle.left_speed_m_s / 0.28 * 9 * 30 / math.pi
    assert vehicle.motors[LEFT].speed_rpm == pytest.approx(expected_rpm, rel=0.05)


def test_more_throttle_and_a_stronger_mode_accelerate_more() -> None:
    weaker_first = [
        FULL | {"Throttle": 10, "PowerMode": 0},
        FULL | {"Throttle": 50, "PowerMode": 0},
        FULL | {"PowerMode": 0},
        FULL | {"PowerMode": 1},
        FULL | {"PowerMode": 2},
    ]
    speeds = [Drive().hold(1, values).speed_m_s for values in weaker_first]
    assert speeds == sorted(speeds)
    assert len(set(speeds)) == len(speeds)


@pytest.mark.parametrize(
    "change", [{"PowerMode": 3}, {"PowerCut": 1}, {"PowerLimit": 0}, {"SpeedLimit": 0}]
)
def test_safety_mode_power_cut_and_limits_of_zero_make_no_torque(change: dict[str, float]) -> None:
    vehicle = Drive().hold(2, FULL | change)
    assert vehicle.speed_m_s == 0
    assert vehicle.motors[LEFT].torque_nm == 0


def test_zero_torque_coasts_down_slowly_to_a_stop_and_stays_there() -> None:
    drive = Drive()
    rolling_m_s = drive.hold(3, FULL).speed_m_s
    coasting = drive.hold(2, ZERO_TORQUE)
    assert 0.8 * rolling_m_s < coasting.speed_m_s < rolling_m_s
    assert -1 < coasting.acceleration_m_s2 < 0
    stopped = drive.hold(120, ZERO_TORQUE)
    assert stopped.speed_m_s == 0
    assert stopped.acceleration_m_s2 == 0


def test_reverse_drives_backwards() -> None:
    vehicle = Drive().hold(2, FULL | {"MotorReverse": 1})
    assert vehicle.speed_m_s < -3
    assert vehicle.motors[LEFT].speed_rpm < -1000
    assert power_w(vehicle) > 1000


def test_the_brake_stops_the_vehicle_and_never_turns_it_round() -> None:
    drive = Drive()
    drive.hold(2, FULL)
    slowest_m_s = min(drive.hold(0.05, ZERO_TORQUE | {"Brake": 80}).speed_m_s for _ in range(80))
    assert slowest_m_s == 0


def test_regeneration_charges_the_battery_and_slows_more_than_coasting() -> None:
    drive = Drive()
    drive.hold(3, FULL)
    soc_pct = drive.vehicle.battery.soc_pct
    regenerating = drive.hold(1, ZERO_TORQUE | {"Brake": 10, "RegenBrake": 1})
    assert regenerating.battery.current_a < 0
    assert regenerating.battery.state == 1
    assert regenerating.battery.soc_pct > soc_pct
    assert regenerating.motors[LEFT].phase_current_a < 0
    assert regenerating.acceleration_m_s2 < -1


def test_the_brake_without_regeneration_charges_nothing() -> None:
    drive = Drive()
    drive.hold(3, FULL)
    assert drive.hold(1, ZERO_TORQUE | {"Brake": 10}).battery.current_a >= 0


@pytest.mark.parametrize("limit_w", [0, 500, 3000, 8000])
def test_the_power_limit_holds_for_each_motor_at_every_speed(limit_w: float) -> None:
    drive = Drive()
    for _ in range(200):
        vehicle = drive.hold(0.05, FULL | {"PowerLimit": limit_w})
        assert all(motor.power_w <= limit_w + 1e-6 for motor in vehicle.motors.values())
    assert (vehicle.speed_m_s > 0) == (limit_w > 0)


@pytest.mark.parametrize("limit_rpm", [500, 1000, 3000])
def test_a_motor_at_its_speed_limit_pushes_no_more(limit_rpm: float) -> None:
    drive = Drive()
    fastest_rpm = 0.0
    for _ in range(400):
        vehicle = drive.hold(0.05, FULL | {"SpeedLimit": limit_rpm})
        for motor in vehicle.motors.values():
            assert motor.speed_rpm < limit_rpm or motor.torque_nm == 0
            fastest_rpm = max(fastest_rpm, motor.speed_rpm)
    # In a turn the inner motor, still below its limit, pushes the outer one a little beyond.
    assert 0.8 * limit_rpm < fastest_rpm < 1.02 * limit_rpm


def test_a_controller_without_a_command_for_500_ms_goes_to_zero_torque_by_itself() -> None:
    drive = Drive()
    drive.hold(1, FULL)  # the last command came 50 ms before the end
    assert drive.silence(0.45).motors[LEFT].torque_nm > 0
    silent = drive.silence(STEP_NS / S_NS)
    assert silent.motors[LEFT].torque_nm == 0
    assert silent.motors[LEFT].order == Command()


def test_the_time_out_of_one_controller_leaves_the_other_alone() -> None:
    vehicle = Vehicle(0)
    vehicle.command(RIGHT, FULL, 0)
    for now_ns in range(0, S_NS, COMMAND_PERIOD_NS):
        vehicle.command(LEFT, FULL, now_ns)
    vehicle.advance(S_NS)
    assert vehicle.motors[LEFT].torque_nm > 0
    assert vehicle.motors[RIGHT].torque_nm == 0


def test_driving_drains_the_battery_and_the_voltage_sags_with_the_current() -> None:
    drive = Drive(soc_pct=80)
    at_rest_v = drive.vehicle.battery.voltage_v
    vehicle = drive.hold(3, FULL)
    assert vehicle.battery.soc_pct < 80
    assert vehicle.battery.current_a > 100
    assert vehicle.battery.state == 2
    assert vehicle.battery.voltage_v < at_rest_v - 2


def test_the_battery_speedup_multiplies_the_drain() -> None:
    used_pct = [
        80 - Drive(battery_speedup=speedup).hold(1, FULL).battery.soc_pct for speedup in (1, 10)
    ]
    assert used_pct[1] == pytest.approx(10 * used_pct[0], rel=0.02)


@pytest.mark.parametrize(
    ("soc_pct", "level"), [(15.1, 0), (14.9, 1), (5.1, 1), (4.9, 2), (2.1, 2), (1.9, 3), (0, 3)]
)
def test_undervoltage_levels_follow_the_state_of_charge(soc_pct: float, level: int) -> None:
    assert Vehicle(0, soc_pct=soc_pct).battery.undervoltage_level == level


def test_an_overdischarged_battery_drives_no_motor() -> None:
    vehicle = Drive(soc_pct=1).hold(1, FULL)
    assert vehicle.speed_m_s == 0


def test_work_warms_motor_controller_and_pack_slowly_and_rest_cools_them() -> None:
    drive = Drive(soc_pct=100)
    warm = drive.hold(60, FULL | {"Brake": 20})
    motor = warm.motors[LEFT]
    temperatures_c = (motor.motor_c, motor.controller_c, warm.battery.temperature_c)
    assert all(26 < temperature_c < 60 for temperature_c in temperatures_c)
    drive.hold(60, ZERO_TORQUE)
    assert motor.motor_c < temperatures_c[0]
    assert motor.controller_c < temperatures_c[1]


def test_a_hot_controller_drops_turbo_and_a_hotter_one_drives_no_more() -> None:
    drive = Drive()
    motor = drive.vehicle.motors[LEFT]
    motor.controller_c = 90.0
    drive.hold(0.1, FULL)
    assert (motor.temperature_protect_level, motor.order.power_mode) == (1, PowerMode.NORMAL)
    motor.controller_c = 110.0
    drive.hold(0.1, FULL)
    assert (motor.temperature_protect_level, motor.order.power_mode) == (2, PowerMode.SAFETY)
    assert motor.torque_nm == 0


def test_in_a_left_turn_the_right_wheels_are_faster_and_the_body_leans_right() -> None:
    drive = Drive()
    for _ in range(200):
        vehicle = drive.hold(0.05, FULL)
        if vehicle.steering_deg > 2 and vehicle.speed_m_s > 3:
            break
    assert vehicle.right_speed_m_s > vehicle.left_speed_m_s
    assert vehicle.yaw_rate_deg_s > 0
    assert vehicle.lateral_acceleration_m_s2 > 0
    assert vehicle.roll_deg > 0


@pytest.mark.parametrize("reverse", [0, 1])
def test_the_driver_keeps_the_heading(reverse: int) -> None:
    drive = Drive()
    headings_deg = [
        drive.hold(0.5, FULL | {"MotorReverse": reverse}).heading_deg for _ in range(120)
    ]
    assert max(map(abs, headings_deg)) < 45


def test_what_happens_does_not_depend_on_how_often_time_is_looked_at() -> None:
    often, seldom = Vehicle(0), Vehicle(0)
    for vehicle in (often, seldom):
        vehicle.command(LEFT, FULL, 0)
    for now_ns in range(0, 400_000_000, 1_000_000):
        often.advance(now_ns)
    for vehicle in (often, seldom):
        vehicle.advance(400_000_000)
    assert often.speed_m_s == seldom.speed_m_s > 0


def test_after_a_long_pause_only_the_last_second_is_caught_up() -> None:
    vehicle = Vehicle(0)
    vehicle.command(LEFT, FULL, 0)
    vehicle.advance(3600 * S_NS)
    assert vehicle.speed_m_s == 0  # the command was an hour old by then
    assert vehicle.battery.soc_pct == pytest.approx(80, abs=0.01)


def test_time_that_goes_backwards_changes_nothing() -> None:
    drive = Drive()
    before_m_s = drive.hold(1, FULL).speed_m_s
    drive.vehicle.advance(0)
    assert drive.vehicle.speed_m_s == before_m_s


@pytest.mark.parametrize("values", [{}, {"Throttle": 50}, FULL | {"PowerMode": 7}])
def test_an_order_with_something_missing_or_unknown_makes_no_torque(
    values: dict[str, float],
) -> None:
    drive = Drive()
    assert drive.hold(0.5, values).motors[LEFT].torque_nm == 0


@given(
    st.dictionaries(st.sampled_from([*FULL, "Brake", "RegenBrake", "MotorReverse"]), st.floats())
)
@settings(max_examples=100)
def test_no_number_makes_an_order_out_of_bounds(values: dict[str, float]) -> None:
    order = order_of(values)
    assert 0 <= order.throttle_pct <= 100
    assert 0 <= order.brake_pct <= 100
    assert order.speed_limit_rpm >= 0
    assert order.power_limit_w >= 0
    vehicle = Drive().hold(0.2, values)
    assert math.isfinite(vehicle.speed_m_s)


def spin_kmh(vehicle: Vehicle) -> float:
    """How much faster the faster driven wheel turns than its front wheel rolls."""
    road_m_s = {LEFT: vehicle.left_speed_m_s, RIGHT: vehicle.right_speed_m_s}
    return max(vehicle.wheels[name].speed_m_s - road_m_s[name] for name in road_m_s) * 3.6


def on_a_road(friction: float, throttle_pct: float = 99.45) -> tuple[Vehicle, float]:
    """A vehicle after four seconds from standstill on this road, and its largest spin, km/h."""
    drive = Drive()
    drive.vehicle.slip_on((LEFT, RIGHT), friction)
    throttle = FULL | {"Throttle": throttle_pct}
    return drive.vehicle, max(spin_kmh(drive.hold(0.05, throttle)) for _ in range(80))


def test_much_throttle_spins_the_wheels_on_a_wet_road_and_not_on_a_dry_one() -> None:
    (wet, wet_kmh), (dry, dry_kmh) = on_a_road(0.3, 80), on_a_road(0.9, 80)
    assert wet_kmh > 20 > 10 > dry_kmh
    assert wet.speed_m_s < dry.speed_m_s * 0.6


def test_a_third_of_the_throttle_is_as_fast_on_a_wet_road_and_spins_no_wheel() -> None:
    (full, _), (third, third_kmh) = on_a_road(0.3), on_a_road(0.3, 30)
    assert third_kmh < 8
    assert third.speed_m_s > full.speed_m_s


def test_a_tyre_with_more_grip_than_torque_drives_as_a_wheel_that_never_slips() -> None:
    gripping, rolling = on_a_road(1.2, 20)[0], Drive().hold(4, FULL | {"Throttle": 20})
    # Two wheels of 1.5 kg m2 turn with it, which makes it a tenth heavier.
    assert gripping.speed_m_s == pytest.approx(rolling.speed_m_s * 350 / 388, rel=0.03)


def test_one_slippery_wheel_spins_alone_and_pushes_less() -> None:
    drive = Drive()
    drive.vehicle.slip_on((LEFT,), 0.15)
    drive.vehicle.slip_on((RIGHT,), 0.9)
    wheels = drive.hold(3, FULL | {"Throttle": 60}).wheels
    assert wheels[LEFT].speed_m_s > wheels[RIGHT].speed_m_s + 2
    assert wheels[LEFT].force_n < wheels[RIGHT].force_n


def test_a_spinning_wheel_holds_again_when_the_road_is_dry() -> None:
    drive = Drive()
    drive.vehicle.slip_on((LEFT, RIGHT), 0.1)
    assert spin_kmh(drive.hold(2, FULL)) > 20
    drive.vehicle.slip_on((LEFT, RIGHT), None)
    assert spin_kmh(drive.hold(0.5, FULL | {"Throttle": 20})) < 2


def test_a_standing_vehicle_on_ice_does_not_creep() -> None:
    drive = Drive()
    drive.vehicle.slip_on((LEFT, RIGHT), 0.1)
    assert drive.hold(5, ZERO_TORQUE).speed_m_s == 0


def test_the_friction_brake_follows_the_foot_where_it_is_known() -> None:
    drive = Drive()
    drive.hold(2, FULL)
    drive.vehicle.brake_pedal_pct = 40
    foot_m_s2 = drive.hold(0.2, ZERO_TORQUE).acceleration_m_s2
    assert foot_m_s2 < -2, "though nothing is commanded"
    drive.vehicle.brake_pedal_pct = None
    assert drive.hold(0.2, ZERO_TORQUE).acceleration_m_s2 > -1


def test_a_weak_battery_sags_more_under_the_same_load() -> None:
    strong, weak = (Drive(battery_resistance_ohm=ohm).hold(2, FULL) for ohm in (0.02, 0.08))
    assert weak.battery.voltage_v < strong.battery.voltage_v - 5
