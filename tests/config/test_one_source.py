"""Limits stand once: a line in core/settings.py is all that a new key needs."""

import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from scripts.documents import gateway_yaml

from vcu_gateway.api.methods import ControllerParams
from vcu_gateway.cli import main
from vcu_gateway.cli.demand import demand
from vcu_gateway.client import ControllerValues
from vcu_gateway.config import BenchDemandSection, Config, core_settings, parse
from vcu_gateway.core.demand import ControllerDemand
from vcu_gateway.core.settings import KEYS, Reload, Settings
from vcu_gateway.daemon.reload import is_live
from vcu_gateway.demand_ranges import POWER_LIMIT_HIGHEST_W, RANGES, SPEED_LIMIT_HIGHEST_RPM
from vcu_gateway.judge.limits import JudgedDemand
from vcu_gateway.protocol import dbc, packaged

ROOT = Path(__file__).parents[2]

BEFORE = "    regen_limit_pct: Annotated[\n"
LINE = (
    "    snow_limit_pct: Annotated["
    'float, Interval(ge=5, le=40), Key("limits", Reload.SMALLER, "Throttle in snow.")] = 30.0\n'
)

PROGRAM = """
import dataclasses, json
from scripts.documents import gateway_yaml
from vcu_gateway import config
from vcu_gateway.core.settings import Settings, loosened
from vcu_gateway.daemon.reload import is_live
from vcu_gateway.errors import ConfigError

def refusal(value):
    try:
        config.parse(f"limits: {{snow_limit_pct: {value}}}", "f")
    except ConfigError as error:
        return str(error)

usual = Settings()
print(json.dumps({
    "schema": config.schema()["$defs"]["LimitsSection"]["properties"]["snow_limit_pct"],
    "yaml": gateway_yaml.text(),
    "live": is_live("limits.snow_limit_pct"),
    "smaller": loosened(usual, dataclasses.replace(usual, snow_limit_pct=20.0)),
    "larger": loosened(usual, dataclasses.replace(usual, snow_limit_pct=35.0)),
    "refusals": [refusal(4.9), refusal(5), refusal(40), refusal(40.1), refusal("soon")],
    "setting": config.core_settings(
        config.parse("limits: {snow_limit_pct: 7}", "f")
    ).snow_limit_pct,
}))
"""


@pytest.fixture(scope="module")
def with_line(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """What a copy of the program with one line more says of the new key."""
    source = tmp_path_factory.mktemp("copy") / "src"
    shutil.copytree(ROOT / "src", source, ignore=shutil.ignore_patterns("__pycache__"))
    settings = source / "vcu_gateway" / "core" / "settings.py"
    text = settings.read_text()
    assert text.count(BEFORE) == 1
    settings.write_text(text.replace(BEFORE, LINE + BEFORE))
    environment = {**os.environ, "PYTHONPATH": f"{source}:{ROOT}"}
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(command, env=environment, check=True, capture_output=True)
    said: dict[str, object] = json.loads(done.stdout)
    return said


def test_a_line_in_the_settings_is_in_the_schema(with_line) -> None:
    assert with_line["schema"] == {
        "default": 30.0,
        "description": "Throttle in snow.",
        "maximum": 40,
        "minimum": 5,
        "title": "snow_limit_pct",
        "type": "number",
    }


def test_a_line_in_the_settings_is_in_the_generated_yaml(with_line) -> None:
    assert (
        "  # Throttle in snow.\n"
        "  # Unit %; default 30; minimum 5; maximum 40; live, while active only a smaller value.\n"
        "  snow_limit_pct: 30\n"
    ) in with_line["yaml"]


def test_a_line_in_the_settings_has_its_reload_rules(with_line) -> None:
    assert with_line["live"] is True
    assert with_line["smaller"] == []
    assert with_line["larger"] == ["snow_limit_pct"]


def test_a_line_in_the_settings_is_checked_in_a_file_and_reaches_the_core(with_line) -> None:
    assert with_line["refusals"] == [
        "f:1: limits.snow_limit_pct: must be at least 5 %, not 4.9",
        None,
        None,
        "f:1: limits.snow_limit_pct: must be at most 40 %, not 40.1",
        'f:1: limits.snow_limit_pct: must be a number in %, not "soon"',
    ]
    assert with_line["setting"] == 7.0


def test_the_yaml_marks_the_live_keys_and_no_others() -> None:
    comments = re.findall(r"((?:^ +#.*\n)+) +#?(\w+):", gateway_yaml.text(), re.MULTILINE)
    marked = {name for comment, name in comments if re.search(r";\s+(?:# )?live,", comment)}
    assert marked == {name for name, key in KEYS.items() if is_live(f"{key.section}.{name}")}


@pytest.mark.parametrize(
    "name",
    [
        "echo_below_max_pct",
        "motor_speed_step_max_rpm",
        "wheel_speed_step_max_kmh",
        "wheel_speed_difference_max_kmh",
    ],
)
def test_a_limit_that_judges_several_frames_together_needs_a_restart(name: str) -> None:
    assert KEYS[name].reload is Reload.NEVER
    assert not is_live(f"{KEYS[name].section}.{name}")


def test_the_default_configuration_gives_the_default_settings() -> None:
    assert core_settings(Config()) == Settings()


def test_every_setting_that_has_a_key_is_that_key_of_its_section() -> None:
    fields = {field.name for field in dataclasses.fields(Settings)}
    assert fields - KEYS.keys() == {"period_ns", "bench_demand", "tuning", "pedals"}
    sections = Config.model_fields
    for name, key in KEYS.items():
        assert name in sections[key.section].annotation.model_fields


def test_the_bench_demand_reaches_the_core_whole() -> None:
    text = (
        "bench: {demand: {bench_use_only: true, throttle_pct: 1, brake_pct: 2, power_mode: turbo,"
        " motor_reverse: true, regen_brake: true, speed_limit_rpm: 3, power_limit_w: 4}}"
    )
    asked = core_settings(parse(text, "f")).bench_demand
    assert asked is not None
    assert dataclasses.asdict(asked) == {
        "throttle_pct": 1,
        "brake_pct": 2,
        "power_mode": 2,
        "motor_reverse": True,
        "regen_brake": True,
        "speed_limit_rpm": 3,
        "power_limit_w": 4,
        "throttle_track2_pct": None,
    }


DEMAND = {item.name: item.default for item in dataclasses.fields(ControllerDemand)}
BENCH = BenchDemandSection.model_json_schema()["properties"]


def test_every_list_of_a_demands_fields_has_all_of_them() -> None:
    assert set(ControllerParams.model_fields) == set(DEMAND)
    assert set(ControllerValues.__annotations__) == set(DEMAND)
    assert {option.name for option in demand.params} >= set(DEMAND)
    assert set(BENCH) == set(DEMAND) - {"throttle_track2_pct"} | {"bench_use_only"}
    assert JudgedDemand._fields == tuple(DEMAND)
    assert set(RANGES) == {name for name, kind in DEMAND.items() if not isinstance(kind, int)}


def test_a_demands_fields_have_the_same_range_and_default_everywhere() -> None:
    for name in RANGES.keys() & BENCH.keys():
        assert (BENCH[name]["minimum"], BENCH[name]["maximum"]) == RANGES[name]
    default = DEMAND | {"power_mode": DEMAND["power_mode"].name.lower()}
    for name in default.keys() & BENCH.keys():
        assert BENCH[name]["default"] == default[name]
    for name, field in ControllerParams.model_fields.items():
        assert field.default in (None, default[name])


@pytest.mark.parametrize("name", ["PCU1", "PCU2"])
def test_the_largest_limits_of_a_command_are_the_protocols(name: str) -> None:
    command = dbc.load(packaged("vcu.dbc")).message(f"VCU_{name}_Command")
    assert command.signal("SpeedLimit").maximum == SPEED_LIMIT_HIGHEST_RPM
    assert command.signal("PowerLimit").maximum == POWER_LIMIT_HIGHEST_W
    assert RANGES["speed_limit_rpm"] == (0, SPEED_LIMIT_HIGHEST_RPM)
    assert RANGES["power_limit_w"] == (0, POWER_LIMIT_HIGHEST_W)


def test_the_yaml_in_the_repository_is_the_generated_one() -> None:
    assert (ROOT / "config" / "gateway.yaml").read_text() == gateway_yaml.text()


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["vcu-gateway", "schema", *arguments])
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


def test_schema_prints_the_yaml(monkeypatch, capsys) -> None:
    assert run(monkeypatch, "--yaml") == 0
    assert capsys.readouterr().out == gateway_yaml.text()


def test_schema_refuses_options_that_mean_nothing_together(monkeypatch) -> None:
    assert run(monkeypatch, "--yaml", "--api") == 2
