"""The configuration file: what is read, what is refused, and how that reads to a person."""

import contextlib
import errno
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from vcu_gateway.cli import main
from vcu_gateway.cli.options import DEFAULT_CONFIG, resolve_config
from vcu_gateway.config import Config, check_against, digest, effective, load, parse, schema
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.errors import ConfigError, GatewayError, MissingInputError
from vcu_gateway.protocol import dbc, packaged

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "config" / "gateway.yaml"
BENCH = ROOT / "config" / "bench-vcan0.yaml"

HEALTHY = """\
bus:
  interface: socketcan
  channel: can0
  bit_rate_bit_s: 250000
  kernel_filters: true
  receive_buffer_bytes: 1048576
  reopen_ms: 200
protocol:
  aliases:
    0x08F02DE2: IMU_Attitude
  status_code_names:
    3: overvoltage
freshness:
  stale_after_ms:
    BMS_Status: 1600
  late_after_ms:
    BMS_Status: 1100
limits:
  speed_limit_max_rpm: 3000
bench:
  demand:
    bench_use_only: true
    throttle_pct: 10
    power_mode: normal
    speed_limit_rpm: 2000
log:
  level: info
"""


@pytest.fixture(scope="module")
def protocol() -> ProtocolSpec:
    return dbc.load(packaged("vcu.dbc"))


def changed(line: str, replacement: str) -> str:
    """The healthy file with one line replaced."""
    assert HEALTHY.count(f"{line}\n") == 1, line
    return HEALTHY.replace(f"{line}\n", replacement + "\n")


def errors(text: str) -> list[str]:
    """What a person reads about this file; empty if it is good."""
    try:
        parse(text, "gateway.yaml")
    except ConfigError as error:
        return [str(problem) for problem in error.problems]
    return []


def load_errors(path: Path, kind: type[GatewayError] = ConfigError) -> list[str]:
    with pytest.raises(kind) as caught:
        load(path)
    return [str(problem) for problem in caught.value.problems]


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    monkeypatch.setattr(sys, "argv", ["vcu-gateway", *arguments])
    try:
        main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


# The files that ship.


def uncommented(text: str) -> str:
    """The example with every commented-out key put in."""
    pattern = r"^( *)#(?=$| {2,}(?:#|[a-z_]+2?:)|[a-z_]+:)"
    return re.sub(pattern, r"\1", text, flags=re.MULTILINE)


def key_facts() -> Iterator[tuple[str, str]]:
    """(full name, last line of the comment above it) of every key in the example."""
    parents: list[tuple[int, str]] = []
    comment = ""
    for line in uncommented(EXAMPLE.read_text()).splitlines():
        if match := re.fullmatch(r"( *)([a-z_]+2?):.*", line):
            indent, name = len(match[1]), match[2]
            parents = [parent for parent in parents if parent[0] < indent]
            parents.append((indent, name))
            yield ".".join(name for _, name in parents), comment
        comment = line.strip().removeprefix("# ") if line.strip().startswith("#") else ""


FACTS = dict(key_facts())
LEAVES = [
    name for name, fact in FACTS.items() if "." in name and re.search("[Dd]efault|Required", fact)
]
RANGED = [name for name in LEAVES if "minimum" in FACTS[name]]
UNITS = {"rpm_per_kmh": "rpm per km/h", "kmh": "km/h",
         "bit_s": "bit/s", "bytes": "bytes", "ms": "ms", "pct": "%", "rpm": "rpm", "w": "W",
         "pct_per_s": "%/s", "w_per_s": "W/s"}  # fmt: skip


REQUIRED = {
    "demand": {"bench_use_only"},
    "can": {"message", "throttle"},
    "checksum": {"signal", "kind"},
    **{key: {"signal", "released", "pressed"} for key in ("throttle", "throttle_track2", "brake")},
}
"""Keys without a default, by the section that has them."""


def model_keys(part: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every key below a part of the JSON Schema, with its entry."""
    definitions = schema()["$defs"]
    for name, entry in part.get("properties", {}).items():
        yield prefix + name, entry
        kinds = [entry, *entry.get("anyOf", [])]
        for reference in (kind["$ref"] for kind in kinds if "$ref" in kind):
            yield from model_keys(definitions[reference.split("/")[-1]], f"{prefix}{name}.")


PEDALS = (
    "pedals: {can: {message: Pedals, single_track_bench_use_only: true, throttle: {signal: Throttle"
    ", released: 1, pressed: 2}}}\n"
)


def default_of(name: str) -> Any:
    value: Any = Config()
    if name.startswith("bench.demand."):
        value = parse("bench: {demand: {bench_use_only: true}}", "gateway.yaml")
    if name == "pedals.can.single_track_bench_use_only":
        return None
    if name.startswith("pedals.can."):
        value = parse(PEDALS, "gateway.yaml")
    if name.startswith("laws.slip."):
        value = parse("vehicle: {motor_rpm_per_kmh: 85}\nlaws: {slip: {}}", "gateway.yaml")
    for key in name.split("."):
        value = getattr(value, key)
    return value


def one_key(name: str, value: Any) -> str:
    """A file that sets one key and what it cannot be without."""
    *sections, key = name.split(".")
    content: dict[str, Any] = {key: value}
    if name.startswith("bench.demand."):
        content["bench_use_only"] = True
    for section in reversed(sections):
        content = {section: content}
    if name.startswith("pedals.can."):
        content["pedals"]["can"] |= yaml.safe_load(PEDALS)["pedals"]["can"] | {key: value}
    if name.startswith("laws.slip."):
        content["vehicle"] = {"motor_rpm_per_kmh": 85}
    return str(yaml.safe_dump(content))


def test_the_example_loads_to_the_defaults() -> None:
    assert load(EXAMPLE) == Config()
    assert digest(load(EXAMPLE)) == digest(Config())


def test_the_packaged_example_is_the_one_in_the_repository() -> None:
    assert packaged("gateway.yaml").read_text() == EXAMPLE.read_text()


def test_the_example_lists_every_key_of_the_model_and_no_other() -> None:
    assert set(FACTS) == ENTRIES.keys()


def test_the_example_loads_with_every_commented_key_put_in(tmp_path: Path) -> None:
    file = tmp_path / "gateway.yaml"
    file.write_text(uncommented(EXAMPLE.read_text()))
    shutil.copy(packaged("vcu.dbc"), tmp_path)
    config = load(file)
    assert config.bench.demand is not None
    assert config.bus.receive_buffer_bytes is not None
    assert config.protocol.dbc == tmp_path / "vcu.dbc"


@pytest.mark.parametrize("name", LEAVES)
def test_every_comment_in_the_example_states_the_default(name: str) -> None:
    if "Required" in FACTS[name]:
        *_, section, key = name.split(".")
        assert key in REQUIRED[section]
        return
    stated = re.search(r"[Dd]efault (\{.*?\}|[^;]*?)(?:;|\.$)", FACTS[name])
    assert stated, FACTS[name]
    default = default_of(name)
    assert yaml.safe_load(stated[1]) == (list(default) if isinstance(default, tuple) else default)


@pytest.mark.parametrize("name", RANGED)
def test_every_comment_in_the_example_states_the_range(name: str) -> None:
    stated = re.search(r"(\w+: )?minimum (\w+); maximum (\w+)[.;]", FACTS[name])
    assert stated, FACTS[name]
    wrappers: dict[str | None, Callable[[int], object]] = {
        "keys: ": lambda number: {number: "IMU_Attitude"},
        "values: ": lambda number: {"BMS_Status": number},
        None: lambda number: number,
    }
    wrap = wrappers[stated[1]]
    lowest, highest = int(stated[2], 0), int(stated[3], 0)
    for number, allowed in (
        (lowest - 1, False),
        (lowest, True),
        (highest, True),
        (highest + 1, False),
    ):
        assert (errors(one_key(name, wrap(number))) == []) is allowed, number


ENTRIES = dict(model_keys(schema()))
"""What the schema says of each key."""


@pytest.mark.parametrize("name", LEAVES)
def test_every_number_has_its_range_and_unit_in_the_example(name: str) -> None:
    entry = ENTRIES[name]
    kinds = {entry.get("type")} | {kind.get("type") for kind in entry.get("anyOf", [])}
    unit = next((text for end, text in UNITS.items() if name.endswith(f"_{end}")), None)
    if ".by_" in name:  # a curve: its comment has both units and ranges
        unit = None
    assert FACTS[name].startswith(f"Unit {unit}; ") is (unit is not None)
    is_number = bool(kinds & {"integer", "number", "object"}) and "string" not in kinds
    is_number = is_number and name not in ("drive_modes.modes", "laws.slip")
    is_number = is_number and not name.endswith((".released", ".pressed"))  # of any signal
    assert ("minimum" in FACTS[name]) is is_number


@pytest.mark.parametrize("name", LEAVES)
def test_every_choice_is_listed_in_the_example(name: str) -> None:
    entry = ENTRIES[name]
    choices = ["true", "false"] if entry.get("type") == "boolean" else entry.get("enum", [])
    if choices and "const" not in entry:
        assert re.search(rf"; one of {', '.join(choices)}(?:\.$|; live,)", FACTS[name])


def test_every_key_of_the_model_has_a_description() -> None:
    without = {
        name
        for name, entry in ENTRIES.items()
        if not (entry.get("description") or "$ref" in entry)  # a section has its own
    }
    assert without <= schema()["properties"].keys()
    assert all(section["description"] for section in schema()["$defs"].values())


def test_the_bench_file_loads_with_a_demand_on_vcan0(protocol: ProtocolSpec) -> None:
    config = load(BENCH)
    assert config.bus.channel == "vcan0"
    assert config.bench.demand is not None
    assert check_against(config, protocol) == []


# What is read.


def test_the_healthy_file_is_healthy(protocol: ProtocolSpec) -> None:
    assert check_against(parse(HEALTHY, "gateway.yaml"), protocol) == []


def test_a_byte_order_mark_is_accepted(tmp_path: Path) -> None:
    file = tmp_path / "gateway.yaml"
    file.write_bytes(b"\xef\xbb\xbf" + HEALTHY.encode())
    assert load(file) == parse(HEALTHY, "")


def test_windows_line_ends_are_accepted_and_lines_counted_once(tmp_path: Path) -> None:
    file = tmp_path / "gateway.yaml"
    file.write_bytes(HEALTHY.replace("\n", "\r\n").encode())
    assert load(file) == parse(HEALTHY, "")
    file.write_bytes(changed("  reopen_ms: 200", "  reopen_ms: 20").replace("\n", "\r\n").encode())
    assert load_errors(file) == [f"{file}:7: bus.reopen_ms: must be at least 50 ms, not 20"]


def test_a_whole_number_is_accepted_for_a_number_with_decimals() -> None:
    assert parse("limits: {regen_limit_pct: 3}", "").limits.regen_limit_pct == 3.0


def test_unquoted_off_is_text_where_text_is_meant() -> None:
    config = parse("protocol: {status_code_names: {3: off, 4: no}}", "")
    assert config.protocol.status_code_names == {3: "off", 4: "no"}


def test_an_empty_mapping_switches_the_aliases_off() -> None:
    assert parse("protocol: {aliases: {}}", "").protocol.aliases == {}


def test_a_dbc_is_found_relative_to_the_configuration_file(tmp_path: Path) -> None:
    (tmp_path / "own.dbc").touch()
    file = tmp_path / "gateway.yaml"
    file.write_text("protocol: {dbc: own.dbc}")
    assert load(file).protocol.dbc == tmp_path / "own.dbc"
    file.write_text("protocol: {dbc: other.dbc}")
    expected = f"{file}:1: protocol.dbc: no file can be found at {tmp_path / 'other.dbc'}"
    assert load_errors(file) == [expected]


def test_a_relative_configuration_path_still_gives_the_whole_path_of_the_dbc(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.dbc").touch()
    (tmp_path / "gateway.yaml").write_text("protocol: {dbc: own.dbc}")
    monkeypatch.chdir(tmp_path)
    assert load(Path("gateway.yaml")).protocol.dbc == tmp_path / "own.dbc"


def test_a_bench_demand_without_limits_has_the_maximum_speed_and_no_power_limit() -> None:
    limits = "limits: {speed_limit_max_rpm: 500, power_limit_max_w: 400}"
    demand = parse(f"{limits}\nbench: {{demand: {{bench_use_only: true}}}}", "").bench.demand
    assert demand is not None
    assert (demand.speed_limit_rpm, demand.power_limit_w) == (500, 60000)


def test_a_configuration_cannot_be_changed_once_it_is_read() -> None:
    with pytest.raises(ValueError, match="frozen"):
        setattr(Config().bus, "reopen_ms", 100)  # noqa: B010


@pytest.mark.parametrize("interface", ["socketcan", "virtual"])
def test_any_network_interface_can_be_the_channel(interface: str) -> None:
    assert errors(f"bus: {{interface: {interface}, channel: slcan-1.5}}") == []


@pytest.mark.parametrize("address", ["239.74.163.2", '"ff15:7079:7468:6f6e:6465:6d6f:6d63:6173"'])
def test_a_multicast_address_can_be_the_channel_of_udp_multicast(address: str) -> None:
    assert errors(f"bus: {{interface: udp_multicast, channel: {address}}}") == []


# What is refused: one thing is broken, one line says which.

_PLAIN = "write the plain number, without quotes, unit or leading zeros"
_COLON = "write `key: value`, with a space after the colon"
_SECTIONS = (
    "the keys here are bus, protocol, freshness, vehicle, limits, curves, drive_modes, laws,"
    " safety, demand, pedals, api, recorder, bench, log"
)
_AT_LEAST = "write at least one section, such as `bus:` with `channel: can0` below it"
_EXPORTER = (
    "remove it: the metrics are served by a program of their own,"
    " vcu-gateway-exporter.service or `vcu-gateway exporter`"
)
_WHEELS = "it confirms that the wheels are off the ground"

BROKEN = [
    # unknown keys
    ("  channel: can0", "  chanel: can0", '3: bus.chanel: unknown key; did you mean "channel"?'),
    (
        "log:",
        "api: {metrics_port: 9464}\nlog:",
        f"26: api.metrics_port: unknown key; {_EXPORTER}",
    ),
    (
        "  channel: can0",
        "  channel: can0\n  gather_ms: 17",
        "4: bus.gather_ms: unknown key; remove it: the bus is read before every tick",
    ),
    ("log:", "lgo:", '26: lgo: unknown key; did you mean "log"?'),
    ("log:", "channel: can1\nlog:", '26: channel: unknown key; did you mean "bus.channel"?'),
    ("log:", "colour: red\nlog:", f"26: colour: unknown key; {_SECTIONS}"),
    ("log:", "5: red\nlog:", f"26: 5: unknown key; {_SECTIONS}"),
    ("log:", "<<: {}\nlog:", f"26: <<: unknown key; {_SECTIONS}"),
    ("log:", "log:{format: json}\nlog:", f"26: log:{{format: unknown key; {_COLON}"),
    ("  level: info", "  levle: info", '27: log.levle: unknown key; did you mean "level"?'),
    (
        "  level: info",
        "  zz: 1",
        "27: log.zz: unknown key; the keys here are level, format",
    ),
    # whole numbers
    (
        "  reopen_ms: 200",
        "  reopen_ms: 200 ms",
        f'7: bus.reopen_ms: must be a whole number in ms, not "200 ms"; {_PLAIN}',
    ),
    (
        "  reopen_ms: 200",
        "  reopen_ms: '200'",
        f'7: bus.reopen_ms: must be a whole number in ms, not "200"; {_PLAIN}',
    ),
    (
        "  reopen_ms: 200",
        "  reopen_ms: 0200",
        f'7: bus.reopen_ms: must be a whole number in ms, not "0200"; {_PLAIN}',
    ),
    (
        "  reopen_ms: 200",
        "  reopen_ms: 3:20",
        f'7: bus.reopen_ms: must be a whole number in ms, not "3:20"; {_PLAIN}',
    ),
    (
        "  reopen_ms: 200",
        "  reopen_ms: 200.0",
        "7: bus.reopen_ms: must be a whole number in ms, not 200.0",
    ),
    (
        "  reopen_ms: 200",
        "  reopen_ms: true",
        "7: bus.reopen_ms: must be a whole number in ms, not true",
    ),
    (
        "  reopen_ms: 200",
        "  reopen_ms: soon",
        '7: bus.reopen_ms: must be a whole number in ms, not "soon"',
    ),
    (
        "  reopen_ms: 200",
        "  reopen_ms:",
        (
            "7: bus.reopen_ms: must be a whole number in ms, not empty;"
            " remove the line for the default, which is 200"
        ),
    ),
    ("  reopen_ms: 200", "  reopen_ms: 49", "7: bus.reopen_ms: must be at least 50 ms, not 49"),
    (
        "  reopen_ms: 200",
        "  reopen_ms: 1001",
        "7: bus.reopen_ms: must be at most 1000 ms, not 1001",
    ),
    (
        "  bit_rate_bit_s: 250000",
        "  bit_rate_bit_s: 250",
        "4: bus.bit_rate_bit_s: must be at least 10000 bit/s, not 250",
    ),
    (
        "  speed_limit_max_rpm: 3000",
        "  speed_limit_max_rpm: 20000",
        "19: limits.speed_limit_max_rpm: must be at most 12000 rpm, not 20000",
    ),
    # numbers with decimals
    (
        "    throttle_pct: 10",
        "    throttle_pct: .nan",
        "23: bench.demand.throttle_pct: must be a finite number in %, not .nan",
    ),
    (
        "    throttle_pct: 10",
        "    throttle_pct: -.inf",
        "23: bench.demand.throttle_pct: must be a finite number in %, not -.inf",
    ),
    (
        "    throttle_pct: 10",
        "    throttle_pct: 1e999",
        "23: bench.demand.throttle_pct: must be a finite number in %, not .inf",
    ),
    (
        "    throttle_pct: 10",
        "    throttle_pct: false",
        "23: bench.demand.throttle_pct: must be a number in %, not false",
    ),
    (
        "    throttle_pct: 10",
        "    throttle_pct: 100.01",
        "23: bench.demand.throttle_pct: must be at most 100 %, not 100.01",
    ),
    (
        "    throttle_pct: 10",
        "    throttle_pct: [2]",
        "23: bench.demand.throttle_pct: must be a number in %, not a list",
    ),
    # switches and choices
    (
        "  kernel_filters: true",
        "  kernel_filters: yes",
        '5: bus.kernel_filters: must be true or false, not "yes"; write true',
    ),
    (
        "  kernel_filters: true",
        "  kernel_filters: Off",
        '5: bus.kernel_filters: must be true or false, not "Off"; write false',
    ),
    (
        "  kernel_filters: true",
        "  kernel_filters: 1",
        "5: bus.kernel_filters: must be true or false, not 1",
    ),
    (
        "  level: info",
        "  level: warn",
        (
            '27: log.level: must be one of debug, info, warning, error, not "warn";'
            ' did you mean "warning"?'
        ),
    ),
    # text
    ("  channel: can0", "  channel: 0", "3: bus.channel: must be text, not 0; put it in quotes"),
    (
        "  channel: can0",
        "  channel: can0/x",
        '3: bus.channel: must be the name of a network interface, not "can0/x"; such as can0',
    ),
    (
        "  channel: can0",
        "  channel: a-name-of-17-chars",
        (
            '3: bus.channel: must be the name of a network interface, not "a-name-of-17-chars";'
            " such as can0"
        ),
    ),
    (
        "  interface: socketcan",
        "  interface: udp_multicast",
        (
            '3: bus.channel: must be a multicast address for udp_multicast, not "can0";'
            " such as 239.74.163.2"
        ),
    ),
    (
        "  channel: can0",
        '  channel: "can0\\n"',
        "3: bus.channel: holds the character U+000A, which cannot be read",
    ),
    (
        "  channel: can0",
        '  channel: "can0\\uD800"',
        "3: bus.channel: holds the character U+D800, which cannot be read",
    ),
    (
        "  channel: can0",
        "  channel: can0\u00a0",
        "3: bus.channel: holds the character U+00A0, which cannot be read",
    ),
    # mappings
    (
        "    0x08F02DE2: IMU_Attitude",
        "    0x240CD079: IMU_Attitude",
        (
            "10: protocol.aliases.0x240CD079: the key must be an identifier of 29 bits, at most"
            " 0x1FFFFFFF; bit 29 cannot exist on the wire: write 0x040CD079 (errata E2)"
        ),
    ),
    (
        "    0x08F02DE2: IMU_Attitude",
        "    08F02DE2: IMU_Attitude",
        "10: protocol.aliases.08F02DE2: the key must be a whole number",
    ),
    (
        "    0x08F02DE2: IMU_Attitude",
        "    -1: IMU_Attitude",
        "10: protocol.aliases.-1: the key must be at least 0",
    ),
    (
        "    0x08F02DE2: IMU_Attitude",
        "    0x08F02DE2: 7",
        "10: protocol.aliases.0x08F02DE2: must be text, not 7; put it in quotes",
    ),
    (
        "    0x08F02DE2: IMU_Attitude",
        "",
        (
            "9: protocol.aliases: must be a mapping, key: value in each line, not empty;"
            " write {} for none, or remove the line for the default"
        ),
    ),
    (
        "    3: overvoltage",
        "    65536: overvoltage",
        "12: protocol.status_code_names.65536: the key must be at most 65535",
    ),
    (
        "    3: overvoltage",
        "    0.5: overvoltage",
        "12: protocol.status_code_names: a key must be a word or a whole number, not 0.5",
    ),
    (
        "    3: overvoltage",
        "    [3, 4]: overvoltage",
        "12: protocol.status_code_names: a key must be a word or a whole number, not a list",
    ),
    (
        "    BMS_Status: 1600",
        "    BMS_Status: 0",
        "15: freshness.stale_after_ms.BMS_Status: must be at least 1 ms, not 0",
    ),
    (
        "    BMS_Status: 1600",
        "    BMS_Status:",
        "15: freshness.stale_after_ms.BMS_Status: must be a whole number in ms, not empty",
    ),
    (
        "    BMS_Status: 1600",
        "    BMS_Status: 60001",
        "15: freshness.stale_after_ms.BMS_Status: must be at most 60000 ms, not 60001",
    ),
    # sections
    (
        "  level: info",
        "",
        (
            "26: log: must be a section with keys below it, not empty;"
            " remove the line, or write keys below it"
        ),
    ),
    (
        "  level: info",
        "  level:info",
        f'26: log: must be a section with keys below it, not "level:info"; {_COLON}',
    ),
    ("  level: info", "  - level", "26: log: must be a section with keys below it, not a list"),
    # the bench
    (
        "    bench_use_only: true",
        "",
        f"21: bench.demand.bench_use_only: is missing; must be true: {_WHEELS}",
    ),
    *(
        (
            "    bench_use_only: true",
            f"    bench_use_only: {value}",
            f"22: bench.demand.bench_use_only: must be true, not {text}; {_WHEELS}",
        )
        for value, text in (("false", "false"), ("yes", '"yes"'), ("1", "1"), ("", "empty"))
    ),
    (
        "    throttle_pct: 10",
        "    throttle_pct: 100.5",
        "23: bench.demand.throttle_pct: must be at most 100 %, not 100.5",
    ),
    (
        "    power_mode: normal",
        "    power_mode: sport",
        '24: bench.demand.power_mode: must be one of eco, normal, turbo, safety, not "sport"',
    ),
    (
        "    speed_limit_rpm: 2000",
        "    speed_limit_rpm: 3001",
        (
            "25: bench.demand.speed_limit_rpm: must be at most 3000 rpm, not 3001;"
            " limits.speed_limit_max_rpm says so"
        ),
    ),
    # YAML
    (
        "  channel: can0",
        "  channel: can0\n  channel: can1",
        "4: bus.channel: duplicate key, first defined in line 3; remove one of them",
    ),
    (
        "    0x08F02DE2: IMU_Attitude",
        "    0x08F02DE2: IMU_Attitude\n    149958114: IMU_AngularRate",
        (
            "11: protocol.aliases.0x08F02DE2: duplicate key, first defined in line 10;"
            " remove one of them"
        ),
    ),
    (
        "bus:",
        "bus: {}\nbus:",
        "2: bus: duplicate key, first defined in line 1; remove one of them",
    ),
    (
        "  channel: can0",
        "\tchannel: can0",
        (
            "3: is not valid YAML: while scanning for the next token, found character '\\t' that"
            " cannot start any token; indent with spaces, not with tabs"
        ),
    ),
    (
        "  channel: can0",
        "   channel: can0",
        (
            "3: is not valid YAML: mapping values are not allowed here;"
            " check the indentation, and quote text that holds a colon"
        ),
    ),
    (
        "  channel: can0",
        "  channel can0",
        "3: is not valid YAML: while scanning a simple key, could not find expected ':'; " + _COLON,
    ),
    (
        "  level: info",
        '  level: "info',
        ("27: is not valid YAML: while scanning a quoted scalar, found unexpected end of stream"),
    ),
    (
        "  level: info",
        "  level: @info",
        (
            "27: is not valid YAML: while scanning for the next token, found character '@' that"
            " cannot start any token"
        ),
    ),
    (
        "  level: info",
        '  level: "\\UFFFFFFFF"',
        "27: is not valid YAML: no such character",
    ),
    ("  level: info", "  level: \x07", "27: holds the character U+0007, which cannot be read"),
    (
        "  level: info",
        "  level: !!str info",
        "27: log.level: tags such as !!str are not read here; remove the tag",
    ),
    (
        "  level: info",
        "  level: info\n---\nbus: {}",
        "28: a second document begins here (---); only one is read",
    ),
    ("  level: info", "  level: " + "[" * 9999, "27: is nested too deeply"),
    (
        "  level: info",
        "  level: &loop [*loop]",
        "27: aliases (*loop) are not read here; write the value out",
    ),
    # the API's socket
    (
        "log:",
        "api: {socket_path: control.sock}\nlog:",
        (
            '26: api.socket_path: must be an absolute path, not "control.sock";'
            " such as /run/vcu-gateway/control.sock"
        ),
    ),
    (
        "log:",
        f"api: {{socket_path: /{'é' * 54}}}\nlog:",
        (
            "26: api.socket_path: must be at most 107 bytes long, as the kernel has it,"
            f' not "/{"é" * 38}…"'
        ),
    ),
    *(
        (
            "log:",
            f'api: {{socket_mode: "{mode}"}}\nlog:',
            f'26: api.socket_mode: must be three octal digits, not "{mode}"; such as "0660"',
        )
        for mode in ("0680", "66", "1660", "rw-")
    ),
    *(
        (
            "log:",
            f"api: {{socket_mode: {mode}}}\nlog:",
            (
                f"26: api.socket_mode: must be three octal digits in quotes, not {mode};"
                ' such as "0660"'
            ),
        )
        for mode in ("432", "680", "true", "66.0")  # 432 is 0660 to others
    ),
    # lists
    *(
        (
            "log:",
            f"{section}: {{{key}: one}}\nlog:",
            f'26: {section}.{key}: must be a list, - item in each line, not "one"',
        )
        for section, key in (("safety", "required_messages"), ("api", "operator_users"))
    ),
]


@pytest.mark.parametrize("value", ["5", "one", "[5]", "{a: [b]}", "true", "", "1.5", "[[1], {}]"])
@pytest.mark.parametrize("name", [name for name in LEAVES if not name.startswith("bench")])
def test_no_wrong_value_is_answered_in_a_librarys_words(name: str, value: str) -> None:
    *sections, key = name.split(".")
    for error in errors(f"{': {'.join((*sections, key))}: {value}{'}' * len(sections)}"):
        assert not re.search("Input should|tuple|validation|instance|dictionary", error), error


@pytest.mark.parametrize("written", ['"0660"', "'660'", "0660", "660"])
def test_a_mode_is_read_as_the_documents_write_it_and_as_the_schema_has_it(written: str) -> None:
    mode = parse(f"api: {{socket_mode: {written}}}", "").api.socket_mode
    assert (type(mode), int(mode, 8)) == (str, 0o660)
    entry = schema()["$defs"]["ApiSection"]["properties"]["socket_mode"]
    kinds = {kind["type"]: kind for kind in entry["anyOf"]}
    read = yaml.safe_load(written)  # as an editor reads it: 0660 is 432
    if isinstance(read, str):
        assert re.search(kinds["string"]["pattern"], read)
    else:
        assert kinds["integer"]["exclusiveMinimum"] < read < kinds["integer"]["exclusiveMaximum"]


@pytest.mark.parametrize(("line", "replacement", "expected"), BROKEN)
def test_one_thing_broken_is_one_line_that_says_which(
    line: str, replacement: str, expected: str
) -> None:
    assert errors(changed(line, replacement)) == [f"gateway.yaml:{expected}"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("[]", "must hold sections such as `bus:`, not a list"),
        ("hello", 'must hold sections such as `bus:`, not "hello"; ' + _COLON),
        *(
            (
                text,
                f"is empty; {_AT_LEAST}",
            )
            for text in ("", "\n\n", "# nothing but a comment\n", "---\n", "null", "\ufeff")
        ),
    ],
)
def test_a_file_that_holds_no_section_is_refused(text: str, expected: str) -> None:
    assert errors(text) == [f"gateway.yaml: {expected}"]


def test_a_virtual_bus_needs_a_name() -> None:
    text = "bus: {interface: virtual, channel: ''}"
    assert errors(text) == ['gateway.yaml:1: bus.channel: must be a name, not ""']


def test_all_errors_are_told_at_once_in_the_order_of_the_file() -> None:
    text = HEALTHY
    for line, wrong in (
        ("  level: info", "  level: loud"),
        ("  kernel_filters: true", "  kernel_filters: false\n  kernel_filters: true"),
        ("    3: overvoltage", "    true: overvoltage"),
        ("  channel: can0", "  chanel: can0"),
        ("    throttle_pct: 10", "    throttle_pct: -1"),
    ):
        text = text.replace(line, wrong)
    assert [error.split(": ")[:2] for error in errors(text)] == [
        ["gateway.yaml:3", "bus.chanel"],
        ["gateway.yaml:6", "bus.kernel_filters"],
        ["gateway.yaml:13", "protocol.status_code_names"],
        ["gateway.yaml:24", "bench.demand.throttle_pct"],
        ["gateway.yaml:28", "log.level"],
    ]


def test_very_many_errors_are_counted_beyond_the_first_500() -> None:
    told = errors("bus:\n" + "".join(f"  k{number}: 1\n" for number in range(600)))
    assert len(told) == 501
    assert told[-1] == "gateway.yaml:502: bus.k500: from here on 100 more errors, not shown"


@pytest.mark.timeout(60)
def test_a_bomb_of_aliases_is_refused_at_once() -> None:
    levels = [f"l{i}: &l{i} [{', '.join([f'*l{i - 1}'] * 9)}]" for i in range(1, 99)]
    text = "\n".join(["l0: &l0 [x]", *levels])
    assert errors(text) == ["gateway.yaml:2: aliases (*l0) are not read here; write the value out"]


# Files that cannot be read.


def test_a_missing_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "gateway.yaml"
    assert load_errors(file, MissingInputError) == [f"{file}: there is no such file"]


def test_a_path_through_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    file = tmp_path / "file" / "gateway.yaml"
    assert load_errors(file, MissingInputError) == [f"{file}: there is no such file"]


def test_a_directory_is_refused(tmp_path: Path) -> None:
    assert load_errors(tmp_path, MissingInputError) == [f"{tmp_path}: is a directory, not a file"]


def test_a_loop_of_symbolic_links_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "gateway.yaml"
    file.symlink_to(file)
    assert load_errors(file, MissingInputError) == [
        f"{file}: is a symbolic link that leads back to itself"
    ]


@pytest.mark.timeout(60)
def test_a_pipe_is_refused_without_waiting_for_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert load_errors(tmp_path / "pipe", MissingInputError) == [
        f"{tmp_path / 'pipe'}: is no regular file"
    ]


def test_a_file_that_the_user_may_not_read_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "gateway.yaml"
    file.write_text(HEALTHY)

    def refuse(*_: object, **__: Any) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(file))

    monkeypatch.setattr(Path, "open", refuse)  # root may read everything
    assert load_errors(file, MissingInputError) == [f"{file}: this user may not read it"]


def test_a_name_that_no_file_can_have_is_refused() -> None:
    [error] = load_errors(Path("a\0b"), MissingInputError)  # the rest of the sentence is Python's
    assert error.startswith("a\0b: cannot be read: ")
    assert "embedded null" in error


@pytest.mark.parametrize(
    ("contents", "expected"),
    [
        (
            b"",
            f": is empty; {_AT_LEAST}",
        ),
        (b"\x7fELF\0\0", ": is binary, not text"),
        (HEALTHY.encode("utf-16"), ": is UTF-16 text; save it as UTF-8"),
        (b"bus:\n  channel: \xff\n", ":2: is not UTF-8 text: byte 0xFF; save it as UTF-8"),
        (b"#" * (1 << 20) + b"\n", ": is larger than 1 MiB"),
    ],
)
def test_contents_that_are_no_text_are_refused(
    tmp_path: Path, contents: bytes, expected: str
) -> None:
    file = tmp_path / "gateway.yaml"
    file.write_bytes(contents)
    assert load_errors(file) == [f"{file}{expected}"]


def test_a_file_of_exactly_the_largest_size_is_read(tmp_path: Path) -> None:
    file = tmp_path / "gateway.yaml"
    file.write_bytes(HEALTHY.encode().ljust(1 << 20, b"#"))
    assert load(file) == parse(HEALTHY, "")


# Nothing but a ConfigError, whatever the file.


def assert_readable_or_refused(text: str) -> None:
    for error in errors(text):
        assert error.isprintable(), error
        assert len(error) < 1000


@given(st.binary(max_size=300))
@example(b"bus:\r  channel: \xc2\x85can0")
@example(b"bus: !<%0A> {}")
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_arbitrary_bytes_are_read_or_refused(tmp_path: Path, contents: bytes) -> None:
    file = tmp_path / "gateway.yaml"
    file.write_bytes(contents)
    with contextlib.suppress(ConfigError):
        load(file)


@given(
    st.text(max_size=300) | st.text(alphabet="ab:-?[]{}&*!|>'\"%@`#,.\n\t 01~<=\\xuU", max_size=60)
)
@settings(deadline=None)
def test_arbitrary_text_is_read_or_refused(text: str) -> None:
    assert_readable_or_refused(text)


_NAMES = [name.split(".")[-1] for name in FACTS]
_SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=8)
    | st.dates()
    | st.binary(max_size=4)
    | st.sampled_from(["can0", "virtual", "eco", "IMU_Attitude", "udp_multicast"])
)
_KEYS = st.sampled_from(_NAMES) | st.text(max_size=5) | st.integers() | st.none()
_VALUES = st.recursive(
    _SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(_KEYS, inner, max_size=4),
    max_leaves=12,
)


@given(st.dictionaries(_KEYS, _VALUES, max_size=5))
@settings(deadline=None)
def test_arbitrary_yaml_is_read_or_refused(content: dict[object, object]) -> None:
    assert_readable_or_refused(yaml.safe_dump(content))


@given(st.data())
@settings(deadline=None)
def test_the_example_with_any_value_exchanged_is_read_or_refused(data: st.DataObject) -> None:
    name = data.draw(st.sampled_from(LEAVES))
    assert_readable_or_refused(one_key(name, data.draw(_VALUES)))


@given(st.integers(0, len(HEALTHY)), st.integers(0, 20), st.text(max_size=5))
@settings(deadline=None)
def test_the_healthy_file_with_any_typing_error_is_read_or_refused(
    start: int, length: int, typed: str
) -> None:
    assert_readable_or_refused(HEALTHY[:start] + typed + HEALTHY[start + length :])


# Names of messages.


@pytest.mark.parametrize(
    ("line", "replacement", "expected"),
    [
        (
            "    0x08F02DE2: IMU_Attitude",
            "    0x08F02DE2: IMU_Atitude",
            (
                '10: protocol.aliases.0x08F02DE2: the protocol has no message "IMU_Atitude";'
                ' did you mean "IMU_Attitude"?'
            ),
        ),
        (
            "    0x08F02DE2: IMU_Attitude",
            "    0x1808D0F4: IMU_Attitude",
            (
                "10: protocol.aliases.0x1808D0F4: stands for BMS_Status already"
                " (the priority does not count); remove it"
            ),
        ),
        (
            "    0x08F02DE2: IMU_Attitude",
            "    0x08F02DE2: IMU_Attitude\n    0x00F02DE2: BMS_Status",
            (
                "11: protocol.aliases.0x00F02DE2: stands for IMU_Attitude already"
                " (the priority does not count); remove it"
            ),
        ),
        (
            "    BMS_Status: 1600",
            "    BMS_Statu: 1600",
            (
                '15: freshness.stale_after_ms.BMS_Statu: the protocol has no message "BMS_Statu";'
                ' did you mean "BMS_Status"?'
            ),
        ),
        (
            "    BMS_Status: 1100",
            "    BMS_Status: 1601",
            (
                "17: freshness.late_after_ms.BMS_Status: must be at most 1600 ms, not 1601;"
                " BMS_Status is stale by then"
            ),
        ),
    ],
)
def test_a_message_that_the_protocol_does_not_have_is_refused_with_the_nearest(
    protocol: ProtocolSpec, line: str, replacement: str, expected: str
) -> None:
    config = parse(changed(line, replacement), "gateway.yaml")
    assert [str(p) for p in check_against(config, protocol)] == [f"gateway.yaml:{expected}"]


def test_a_name_near_to_none_is_answered_with_all_of_them(protocol: ProtocolSpec) -> None:
    config = parse("freshness: {late_after_ms: {Radio: 100}}", "gateway.yaml")
    (problem,) = check_against(config, protocol)
    names = ", ".join(message.name for message in protocol.messages)
    assert problem.remedy == f"its messages are {names}"


def test_lateness_is_compared_with_the_period_where_staleness_is_not_configured(
    protocol: ProtocolSpec,
) -> None:
    config = parse("freshness: {late_after_ms: {PCU1_Status2: 201}}", "gateway.yaml")
    assert [problem.what for problem in check_against(config, protocol)] == [
        "freshness.late_after_ms.PCU1_Status2: must be at most 200 ms, not 201"
    ]


@pytest.mark.parametrize(
    ("name", "late_ms", "stale_ms"),
    [("BMS_Status", 2200, 3200), ("PCU1_Status2", 220, 400), ("PCU2_Status2", 220, 400)],
)
def test_a_required_message_may_be_waited_for_at_most_twice_its_default(
    protocol: ProtocolSpec, name: str, late_ms: int, stale_ms: int
) -> None:
    def complaints(late_ms: int, stale_ms: int) -> list[str]:
        ages = f"  late_after_ms: {{{name}: {late_ms}}}\n  stale_after_ms: {{{name}: {stale_ms}}}\n"
        found = check_against(parse(f"freshness:\n{ages}", "f"), protocol)
        return [str(problem) for problem in found]

    remedy = f"{name} is required: at most twice its default"
    assert complaints(late_ms, stale_ms) == []
    assert complaints(late_ms, stale_ms + 1) == [
        (
            f"f:3: freshness.stale_after_ms.{name}: must be at most {stale_ms} ms,"
            f" not {stale_ms + 1}; {remedy}"
        )
    ]
    assert complaints(late_ms + 1, stale_ms) == [
        (
            f"f:2: freshness.late_after_ms.{name}: must be at most {late_ms} ms,"
            f" not {late_ms + 1}; {remedy}"
        )
    ]


def test_any_message_that_the_configuration_requires_may_be_waited_for_so_long_only(
    protocol: ProtocolSpec,
) -> None:
    freshness = "freshness: {stale_after_ms: {IMU_Attitude: 201, ARD2_SteeringWheel: 60000}}\n"
    assert check_against(parse(freshness, "f"), protocol) == []
    required = "[BMS_Status, PCU1_Status2, PCU2_Status2, IMU_Attitude]"
    config = parse(f"{freshness}safety: {{required_messages: {required}}}\n", "f")
    assert [problem.what for problem in check_against(config, protocol)] == [
        "freshness.stale_after_ms.IMU_Attitude: must be at most 200 ms, not 201"
    ]


def test_the_default_alias_is_refused_with_its_remedy_where_the_protocol_lacks_the_message(
    protocol: ProtocolSpec,
) -> None:
    others = tuple(m for m in protocol.messages if m.name != "IMU_Attitude")
    without = ProtocolSpec(others, protocol.nodes)
    assert [str(problem) for problem in check_against(parse("bus: {}", "f"), without)] == [
        (
            'f: protocol.aliases.0x08F02DE2: the protocol has no message "IMU_Attitude";'
            " this alias is the default; write `aliases: {}` for none"
        )
    ]


# Digest, effective values, schema.


def test_the_digest_tells_values_apart_and_nothing_else() -> None:
    assert re.fullmatch("[0-9a-f]{16}", digest(Config()))
    same = "log: {level: info}\nbus:\n  reopen_ms: 200  # as ever\n"
    assert digest(parse(same, "elsewhere.yaml")) == digest(Config())
    assert digest(parse("bus: {reopen_ms: 201}", "")) != digest(Config())
    assert digest(parse("protocol: {aliases: {}}", "")) != digest(Config())


def test_the_effective_values_are_json_and_load_to_the_same_configuration() -> None:
    config = parse(HEALTHY, "gateway.yaml")
    again = parse(json.dumps(effective(config)).replace('"0x08F02DE2"', "0x08F02DE2")
                  .replace('"3"', "3"), "gateway.yaml")  # fmt: skip
    assert digest(again) == digest(config)


def test_the_schema_has_a_title_and_refuses_unknown_keys_everywhere() -> None:
    whole = schema()
    assert whole["title"] == "vcu-gateway configuration"
    sections = [whole, *whole["$defs"].values()]
    assert all(section["additionalProperties"] is False for section in sections)


# The verbs.


def test_check_config_tells_what_matters(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "check-config", "-c", str(EXAMPLE)) == 0
    first, *rest = capsys.readouterr().out.splitlines()
    assert first.startswith(f"{EXAMPLE}: valid")
    assert rest[-3:] == [
        "  bus     socketcan can0, expected at 250000 bit/s",
        "  bench   no static demand",
        f"  digest  {digest(Config())}",
    ]


def test_check_config_shouts_where_a_bench_demand_stands(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "check-config", "-c", str(BENCH)) == 0
    assert (
        "STATIC DEMAND, WHEELS OFF THE GROUND: throttle 20 %, brake 0 %, normal, forward,"
        " at most 3000 rpm and 5000 W"
    ) in capsys.readouterr().out


def test_check_config_prints_the_effective_configuration_as_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "check-config", "--json", "-c", str(BENCH)) == 0
    assert json.loads(capsys.readouterr().out) == effective(load(BENCH))


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("bus: {chanel: can0, reopen_ms: 1}\nlog: {level: loud}\n", 3),
        ("freshness: {late_after_ms: {Radio: 1, Siren: 2}}\n", 2),
        ("bus: [\n", 1),
    ],
)
def test_check_config_prints_each_error_on_a_line_and_exits_with_78(
    text: str,
    count: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "gateway.yaml"
    file.write_text(text)
    assert run(monkeypatch, "check-config", "-c", str(file)) == 78
    printed = capsys.readouterr()
    lines = printed.err.splitlines()
    assert (len(lines), printed.out) == (count, "")
    assert all(line.startswith(f"error: {file}:") for line in lines)


def test_schema_prints_the_schema(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, "schema") == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(schema()))


def test_the_configuration_that_is_given_is_the_one_that_is_read(tmp_path: Path) -> None:
    assert resolve_config(tmp_path / "a.yaml", tmp_path / "b.yaml") == tmp_path / "a.yaml"


def test_without_one_given_the_configuration_in_etc_is_read(tmp_path: Path) -> None:
    default = tmp_path / "gateway.yaml"
    default.symlink_to("nowhere")  # a broken link is told as such, not passed over
    assert resolve_config(None, default) == default
    assert Path("/etc/vcu-gateway/gateway.yaml") == DEFAULT_CONFIG


def test_without_any_configuration_the_error_says_what_to_do(tmp_path: Path) -> None:
    default = tmp_path / "gateway.yaml"
    with pytest.raises(MissingInputError) as caught:
        resolve_config(None, default)
    assert str(caught.value) == (
        f"{default}: there is no configuration file; give one with -c FILE, or begin with the"
        f" example: sudo install -D -m 644 {packaged('gateway.yaml')} {default}"
    )


def test_the_options_do_not_pay_for_the_configuration() -> None:
    program = "import sys, vcu_gateway.cli.options; sys.exit('pydantic' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_a_required_message_that_the_gateway_does_not_receive_is_refused(
    protocol: ProtocolSpec,
) -> None:
    names = "[BMS_Status, PCU1_Status2, PCU2_Status2, VCU_PCU1_Command]"
    config = parse(f"safety: {{required_messages: {names}}}", "f")
    (problem,) = check_against(config, protocol)
    assert problem.what == (
        'safety.required_messages.3: the gateway receives no message "VCU_PCU1_Command"'
    )


def test_the_default_required_messages_cannot_be_left_out() -> None:
    assert errors("safety: {required_messages: [IMU_Attitude, BMS_Status]}") == [
        (
            "gateway.yaml:1: safety.required_messages: must hold BMS_Status, PCU1_Status2,"
            " PCU2_Status2, without which nothing ever moves;"
            " write [BMS_Status, PCU1_Status2, PCU2_Status2], and others after them"
        )
    ]
