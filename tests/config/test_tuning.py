"""Curves, drive modes and laws in the configuration file: what is taken, and each refusal."""

import json
import re
from pathlib import Path

import pytest

from tests.config.test_config import ENTRIES, LEAVES
from vcu_gateway.config import Config, check_effect, core_settings, load, parse, schema, yaml_text
from vcu_gateway.config.tuning import TUNING_SECTIONS
from vcu_gateway.core.settings import RESTART_ONLY, Settings, changed, loosened
from vcu_gateway.core.tuning import DERATINGS, LIMITS, SlipLimiter
from vcu_gateway.daemon.reload import is_live
from vcu_gateway.errors import ConfigError
from vcu_gateway.recording.call_text import settings_json, settings_of

EXAMPLE = Path(__file__).parents[2] / "config" / "examples" / "tuning.yaml"
GEOMETRY = "vehicle: {motor_rpm_per_kmh: 85.3}\n"
MAP = "drive_modes.modes.eco.throttle_pct.by_pedal_pct"
MOTOR = "curves.power_limit_w.by_motor_temperature_c"
CHARGE = "curves.power_limit_w.by_soc_pct"
VOLTAGE = "curves.power_limit_w.by_battery_voltage_v"


def nested(key: str, value: str) -> str:
    *sections, last = key.split(".")
    inner = f"{{{last}: {value}}}"
    for section in reversed(sections[1:]):
        inner = f"{{{section}: {inner}}}"
    return f"{sections[0]}: {inner}\n"


def file_of(key: str, value: str) -> str:
    """A file with this key; line 1 has the geometry."""
    text = nested(key, value)
    if key.startswith("drive_modes.modes.eco."):
        text = text.replace("drive_modes: {", "drive_modes: {start: eco, ")
    return GEOMETRY + text


def refusals(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        parse(text, "gateway.yaml")
    return [str(problem) for problem in caught.value.problems]


WRONG = [
    (CHARGE, "{5: 1}", ": must be a list of points, not a mapping; write [[x, y], [x, y]]"),
    (CHARGE, "7", ": must be a list of points, not 7; write [[x, y], [x, y]]"),
    (
        CHARGE,
        "[[5, 100]]",
        ": must have 2 to 16 points, not 1; a constant is limits.power_limit_max_w",
    ),
    (CHARGE, "[]", ": must have 2 to 16 points, not 0; a constant is limits.power_limit_max_w"),
    (
        "curves.speed_limit_rpm.by_soc_pct",
        "[[5, 1000]]",
        ": must have 2 to 16 points, not 1; a constant is limits.speed_limit_max_rpm",
    ),
    (
        CHARGE,
        str([[x, x] for x in range(17)]),
        ": must have 2 to 16 points, not 17; a constant is limits.power_limit_max_w",
    ),
    (CHARGE, "[[5, 100], [6, 100, 7]]", "[2]: must be [x, y], not 3 numbers"),
    (CHARGE, "[[5, 100], 6]", "[2]: must be [x, y], not 6"),
    (
        MOTOR,
        '[[5, "60 kW"], [6, 1]]',
        '[1]: must be two numbers in °C and W, not "60 kW"; write the plain number',
    ),
    (
        MOTOR,
        "[[5, .nan], [6, 1]]",
        "[1]: must be two numbers in °C and W, not .nan; write the plain number",
    ),
    (
        MOTOR,
        "[[true, 5], [6, 1]]",
        "[1]: must be two numbers in °C and W, not true; write the plain number",
    ),
    (MOTOR, "[[5, 9], [6, 8], [300, 7]]", "[3]: x must be 0 to 255 °C, not 300"),
    (MOTOR, "[[5, 9], [6, 8], [9, 90000]]", "[3]: y must be 0 to 60000 W, not 90000"),
    (
        MOTOR,
        "[[95, 9], [110, 8], [105, 7]]",
        (
            "[3]: 105 °C must lie at least 1 °C above the point before, 110 °C; x rises from point"
            " to point"
        ),
    ),
    (
        VOLTAGE,
        "[[60, 9], [60.05, 10]]",
        (
            "[2]: 60.05 V must lie at least 0.1 V above the point before, 60 V; x rises from point"
            " to point"
        ),
    ),
    (
        MOTOR,
        "[[95, 60000], [110, 20000], [125, 30000]]",
        (
            "[3]: must not rise with the temperature: 30000 W after 20000 W; power falls where it"
            " is hotter"
        ),
    ),
    (
        CHARGE,
        "[[5, 100], [6, 99]]",
        (
            "[2]: must not fall with the state of charge: 99 W after 100 W; power falls where the"
            " battery is emptier"
        ),
    ),
    (
        "curves.brake_pct.by_motor_speed_rpm",
        "[[100, 50], [200, 0]]",
        (
            "[2]: must not fall with the speed: 0 % after 50 %; brake falls where the motors turn"
            " slower"
        ),
    ),
    (
        VOLTAGE,
        "[[60, 0], [66, 58000]]",
        (
            "[2]: rises by 9667 W per V, at most 2500; steeper, power and voltage chase each other."
            " Write it up to what a motor really takes, as limits.power_limit_max_w"
        ),
    ),
    (MAP, "[[0, 1], [100, 80]]", "[1]: must be [0, 0]; a released pedal asks for nothing"),
    (MAP, "[[0, 0], [50, 40], [99, 80]]", "[3]: the last point must be at a pedal of 100 %"),
    (
        MAP,
        "[[0, 0], [20, 30], [100, 80]]",
        "[2]: a pedal of 20 % gives 30 %, more than is asked; at most 20",
    ),
]


@pytest.mark.parametrize(("key", "value", "text"), WRONG)
def test_a_wrong_curve_is_refused_with_the_place_and_what_to_do(key, value, text):
    assert refusals(file_of(key, value)) == [f"gateway.yaml:2: {key}{text}"]


POINTS = "[[1, 20], [2, 20]]"


@pytest.mark.parametrize(
    ("key", "meant"),
    [
        ("power_limit_w.by_motor_temp_c", ["by_motor_temperature_c"]),
        ("power_limit_w.by_motor_temprature_c", ["by_motor_temperature_c"]),
        ("power_limit_w.motor_temperature_c", ["by_motor_temperature_c"]),
        (
            "brake_pct.by_pack_temperature_c",
            ["by_pack_temperature_max_c", "by_pack_temperature_min_c"],
        ),
        (
            "power_limit_w.by_temperature_c",
            [
                "by_motor_temperature_c",
                "by_controller_temperature_c",
                "by_pack_temperature_max_c",
                "by_pack_temperature_min_c",
            ],
        ),
        ("brake_limit_pct", ["brake_pct"]),
        ("regen_limit_pct", ["limits.regen_limit_pct"]),
        (
            "by_soc_pct",
            [
                "curves.power_limit_w.by_soc_pct",
                "curves.brake_pct.by_soc_pct",
                "curves.speed_limit_rpm.by_soc_pct",
            ],
        ),
    ],
)
def test_a_misspelt_curve_is_answered_with_every_key_that_it_may_mean(key, meant):
    (refusal,) = refusals(file_of(f"curves.{key}", POINTS))
    assert re.findall(r'"([^"]+)"', refusal.partition("unknown key; did you mean ")[2]) == meant


@pytest.mark.parametrize(
    "key",
    [
        "power_limit_w.by_motor_speed_rpm",
        "brake_pct.by_motor_temperature_c",
        "brake_pct.by_motor_temp_c",
        "speed_limit_rpm.by_pack_temperature_max_c",
    ],
)
def test_a_curve_that_this_limit_has_not_is_never_answered_with_another_one(key):
    limit = key.partition(".")[0]
    here = [f"by_{one.input.quantity.key}" for one in DERATINGS.values() if one.limit == limit]
    (refusal,) = refusals(file_of(f"curves.{key}", POINTS))
    assert refusal.endswith(f"curves.{key}: unknown key; the keys here are {', '.join(here)}")


def test_a_speed_limit_needs_the_geometry_and_at_least_500_rpm():
    text = "drive_modes: {start: eco, modes: {eco: {speed_limit_kmh: 5}}}\n"
    key = "drive_modes.modes.eco.speed_limit_kmh"
    assert refusals(text) == [
        (
            f"gateway.yaml:1: {key}: needs vehicle.motor_rpm_per_kmh; drive once, and vcu-gateway"
            " replay measures it"
        )
    ]
    assert refusals(GEOMETRY + text) == [
        f"gateway.yaml:2: {key}: is 426 rpm, below the 500 rpm that are ever sent; at least 5.9"
    ]
    parse(GEOMETRY + text.replace("5", "5.9"), "gateway.yaml")


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        ("{start: eko, modes: {eco: {}}}", 'start: there is no mode "eko"; did you mean "eco"?'),
        ("{start: eco}", 'start: there is no mode "eco"; the modes are none'),
        ("{modes: {eco: {}}}", "start: is missing; the mode of every start, such as eco"),
    ],
)
def test_the_start_is_one_of_the_modes(text, refusal):
    assert refusals(f"drive_modes: {text}") == [f"gateway.yaml:1: drive_modes.{refusal}"]


def test_the_slip_limiter_needs_the_geometry():
    assert refusals("laws: {slip: {}}") == [
        "gateway.yaml:1: laws.slip: needs vehicle.motor_rpm_per_kmh"
    ]
    slip = core_settings(parse(GEOMETRY + "laws: {slip: {}}", "f")).tuning.slip
    assert slip == SlipLimiter()


@pytest.mark.parametrize("name", ["Eco", "1st", "a" * 17, "eco-mode", ""])
def test_a_mode_s_name_is_a_short_word(name):
    (refusal,) = refusals(f"drive_modes: {{start: '{name}', modes: {{'{name}': {{}}}}}}")
    assert refusal == (
        f"gateway.yaml:1: drive_modes.modes.{name}: the key must be 1 to 16 small letters, digits"
        " or _, a letter first; such as eco"
    )


def test_there_are_at_most_eight_modes():
    modes = [f"m{number}: {{}}" for number in range(9)]
    parse(f"drive_modes: {{start: m0, modes: {{{', '.join(modes[:8])}}}}}", "f")
    assert refusals(f"drive_modes: {{start: m0, modes: {{{', '.join(modes)}}}}}") == [
        "gateway.yaml:1: drive_modes.modes: must be at most 8 modes, not 9"
    ]


@pytest.mark.parametrize(
    ("key", "taken", "refused", "text"),
    [
        ("power_limit_w", "0", "-1", ": must be at least 0 W, not -1"),
        ("power_limit_w", "60000", "60001", ": must be at most 60000 W, not 60001"),
        ("brake_max_pct", "0", "-1", ": must be at least 0 %, not -1"),
        ("brake_max_pct", "100", "101", ": must be at most 100 %, not 101"),
        ("speed_limit_kmh", "5.9", "2", ": must be at least 3 km/h, not 2"),
        ("speed_limit_kmh", "200", "201", ": must be at most 200 km/h, not 201"),
        (
            "power_mode_max",
            "turbo",
            "safety",
            ': must be one of eco, normal, turbo, not "safety"',
        ),
        (
            "throttle_pct.by_speed_kmh",
            "[[0, 5], [65, 100]]",
            "[[0, 4], [65, 100]]",
            "[1]: y must be 5 to 100 %, not 4",
        ),
        (
            "throttle_pct.by_speed_kmh",
            "[[0, 5], [1, 5]]",
            "[[0, 5], [66, 5]]",
            "[2]: x must be 0 to 65 km/h, not 66",
        ),
        (
            "throttle_pct.by_speed_kmh",
            "[[0, 5], [9, 5]]",
            "[[0, 9], [9, 5]]",
            "[2]: must not fall with the speed: 5 % after 9 %",
        ),
        (
            "throttle_rise_pct_per_s.by_speed_kmh",
            "[[0, 5], [65, 200]]",
            "[[0, 5], [65, 201]]",
            "[2]: y must be 5 to 200 %/s, not 201",
        ),
    ],
)
def test_a_drive_mode_s_keys_are_taken_at_their_ends_and_not_beyond(key, taken, refused, text):
    whole = f"drive_modes.modes.eco.{key}"
    parse(file_of(whole, taken), "f")
    assert refusals(file_of(whole, refused)) == [f"gateway.yaml:2: {whole}{text}"]


@pytest.mark.parametrize("name", DERATINGS)
def test_every_curve_is_taken_at_the_ends_of_its_ranges(name):
    one = DERATINGS[name]
    x, y = one.input.quantity, LIMITS[one.limit]
    ends = (y.lowest, y.highest) if one.rises else (y.highest, y.lowest)
    if one.steepest is not None:
        ends = (0, 60_000)
    points = [[x.lowest, ends[0]], [x.highest, ends[1]]]
    tuning = core_settings(parse(file_of(one.key, str(points)), "f")).tuning
    assert tuning.curves[name].points == tuple(map(tuple, points))
    for index, end, beyond in ((0, 0, -1), (1, 0, 1), (0, 1, -1), (1, 1, 1)):
        wrong = [list(point) for point in points]
        lowest_first = beyond if end == 0 or one.rises else -beyond
        wrong[index][end] += lowest_first
        if one.steepest is None or end == 0:
            (refusal,) = refusals(file_of(one.key, str(wrong)))
            assert f"[{index + 1}]: {'xy'[end]} must be" in refusal


@pytest.mark.parametrize("name", DERATINGS)
def test_the_schema_has_each_curve_with_ranges_units_and_direction(name):
    one = DERATINGS[name]
    definitions = schema()["$defs"]
    section = definitions["CurvesSection"]["properties"][one.limit]["$ref"].split("/")[-1]
    entry = definitions[section]["properties"][f"by_{one.input.quantity.key}"]
    x, y = entry["anyOf"][1]["items"]["prefixItems"]
    assert (x["minimum"], x["maximum"]) == one.input.quantity[3:5]
    assert (y["minimum"], y["maximum"]) == LIMITS[one.limit][3:5]
    assert entry["x-unit"] == [one.input.quantity.unit, LIMITS[one.limit].unit]
    assert entry["x-direction"] == ("must not fall" if one.rises else "must not rise")


def test_the_example_is_taken_and_comes_back_from_text_and_recording():
    config = load(EXAMPLE)
    settings = core_settings(config)
    assert len(settings.tuning.curves) == 10
    assert list(settings.tuning.modes) == ["eco", "sport", "rain", "valet"]
    assert core_settings(parse(yaml_text(config), "f")) == settings
    assert settings_of(json.loads(json.dumps(settings_json(settings)))) == settings
    assert all("the vehicle stops there" in str(hint) for hint in check_effect(config))


def test_without_a_key_a_recording_says_nothing_of_it():
    assert "tuning" not in settings_json(core_settings(Config()))


@pytest.mark.parametrize(
    ("tuning", "text"),
    [
        ({"curves.power": []}, "curves.power"),
        ({MOTOR: 5}, "tuning"),
        ([], "tuning"),
        ({"drive_modes.modes.eco.colour": 1}, "colour"),
    ],
)
def test_a_recorded_tuning_that_is_none_is_refused(tuning, text):
    with pytest.raises(ValueError, match=text):
        settings_of({"tuning": tuning})


def test_a_curve_that_never_limits_is_told_and_prevents_no_start():
    config = parse(file_of(CHARGE, "[[5, 60000], [6, 60000]]"), "gateway.yaml")
    (problem,) = check_effect(config)
    assert str(problem) == f"gateway.yaml:2: {CHARGE}: never limits: every y is at least 60000 W"


def test_a_curve_that_stops_the_vehicle_is_told():
    config = parse(file_of(MOTOR, "[[95, 14000], [125, 499]]"), "gateway.yaml")
    (problem,) = check_effect(config)
    assert str(problem) == (
        f"gateway.yaml:2: {MOTOR}: brings the power down to 499 W: the vehicle stops there"
    )


def test_keys_are_taken_as_the_guide_says():
    assert "drive_modes.start" in RESTART_ONLY
    assert not is_live("drive_modes.start")
    assert is_live(MOTOR)
    assert is_live("drive_modes.modes.eco.power_limit_w")
    before, after = Settings(), core_settings(load(EXAMPLE))
    looser = set(loosened(before, after))
    assert {key for key in changed(before, after) if key.startswith("curves.")} & looser == set()
    assert {key for key in changed(before, after) if key.startswith("drive_modes.")} <= looser


TUNING_KEYS = [name for name in LEAVES if name.partition(".")[0] in TUNING_SECTIONS]


@pytest.mark.parametrize("name", TUNING_KEYS)
def test_every_key_of_the_tuning_says_when_a_reload_takes_it(name):
    assert bool(re.search("[Ll]ive, ", ENTRIES[name]["description"])) is is_live(name)
