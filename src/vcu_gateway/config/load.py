"""Loader: configuration file -> Config, or a ConfigError with every problem; effective values."""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from vcu_gateway.config import pedals
from vcu_gateway.config.model import IDENTIFIER_KEYS, BenchDemandSection, Config, ConfigSource
from vcu_gateway.config.tuning import TUNING_SECTIONS, contradictions, tuning_of
from vcu_gateway.core.demand import ControllerDemand, PowerMode
from vcu_gateway.core.settings import KEYS, Settings
from vcu_gateway.demand_ranges import POWER_LIMIT_HIGHEST_W
from vcu_gateway.errors import ConfigError, Problem
from vcu_gateway.strict_yaml import file_text, parser, validation
from vcu_gateway.strict_yaml.file_text import FileProblem, problems
from vcu_gateway.strict_yaml.parser import YamlDocument

# The bench demand's own limits and what they must not exceed.
_DEMAND_LIMITS = {
    "speed_limit_rpm": "speed_limit_max_rpm",
    "power_limit_w": "power_limit_max_w",
}
# A demand of the highest power sets no limit of its own.
_NO_LIMIT = {"power_limit_w": POWER_LIMIT_HIGHEST_W}


def load(path: Path) -> Config:
    """Read a configuration file; ConfigError names everything that is wrong with it."""
    return parse(file_text.read(path), str(path))


def parse(contents: str, where: str) -> Config:
    """As `load`, from text; `where` is the file that errors name and paths are relative to."""
    return of_document(parser.read(contents), where)


def of_document(read: YamlDocument, where: str) -> Config:
    """As `parse`, from a document that was read before."""
    if read.is_yaml and read.value is None and not read.findings:
        remedy = "write at least one section, such as `bus:` with `channel: can0` below it"
        raise ConfigError(Problem("is empty", where, remedy))
    return _checked(*validation.validated_document(Config, read), ConfigSource(where, read.lines))


def of_values(values: Mapping[str, Any], where: str) -> Config:
    """As `parse`, from the values of a document that was read before; `where` names its source."""
    return _checked(*validation.validated(Config, values), ConfigSource(where))


def _checked(config: Config | None, findings: list[FileProblem], source: ConfigSource) -> Config:
    if config is not None and not findings:
        config = _resolved(config, Path(source.file).parent)
        findings += _contradictions(config)
    if config is None or findings:
        raise ConfigError(*problems(findings, source.file, source.lines, IDENTIFIER_KEYS))
    config.remember_source(source)
    return config


def _resolved(config: Config, folder: Path) -> Config:
    """The effective values: the DBC's whole path, and the highest speed where a demand has none."""
    update: dict[str, object] = {}
    dbc = config.protocol.dbc
    if dbc is not None:
        update["protocol"] = config.protocol.model_copy(update={"dbc": folder.absolute() / dbc})
    if "ttl_default_ms" not in config.demand.model_fields_set:
        ttl_ms = min(config.demand.ttl_default_ms, config.demand.ttl_max_ms)
        update["demand"] = config.demand.model_copy(update={"ttl_default_ms": ttl_ms})
    demand = config.bench.demand
    if demand is not None and "speed_limit_rpm" not in demand.model_fields_set:
        speed = {"speed_limit_rpm": config.limits.speed_limit_max_rpm}
        update["bench"] = config.bench.model_copy(
            update={"demand": demand.model_copy(update=speed)}
        )
    return config.model_copy(update=update)


def _contradictions(config: Config) -> Iterator[FileProblem]:
    """Problems of two keys together, and of files that are not there."""
    ttl_ms, longest_ms = config.demand.ttl_default_ms, config.demand.ttl_max_ms
    if ttl_ms > longest_ms:
        what = f"must be at most {longest_ms} ms, not {ttl_ms}"
        yield FileProblem(("demand", "ttl_default_ms"), what, "demand.ttl_max_ms says so")
    yield from contradictions(config.vehicle, config.drive_modes, config.laws)
    required = config.demand.second_track_required
    yield from pedals.contradictions(config.pedals, second_track_required=required)
    dbc = config.protocol.dbc
    if dbc is not None and not os.path.isfile(dbc):
        yield FileProblem(("protocol", "dbc"), f"no file can be found at {dbc}")
    demand = config.bench.demand
    for name, maximum in _DEMAND_LIMITS.items() if demand is not None else ():
        asked, largest = getattr(demand, name), getattr(config.limits, maximum)
        if asked > largest and asked != _NO_LIMIT.get(name):
            what = f"must be at most {largest} {validation.unit(name)}, not {asked}"
            remedy = f"limits.{maximum} says so"
            yield FileProblem(("bench", "demand", name), what, remedy)


_DIGEST_CHARACTERS = 16


def effective(config: Config) -> dict[str, Any]:
    """Effective values as JSON has them; identifiers as 0x and 8 digits.

    Pedals are there where some are configured: without, text and digest are as before them.
    """
    values = config.model_dump(mode="json")
    if config.pedals.can is None:
        del values["pedals"]
    return values


def yaml_text(config: Config, dbc: str | None = None) -> str:
    """Every effective value as a configuration file, which is read as this configuration again.

    Values that stand at their default are there too. `dbc` is named instead of the whole path of a
    DBC that is not the packaged one.
    """
    values = effective(config)
    if dbc is not None and config.protocol.dbc is not None:
        values["protocol"]["dbc"] = dbc
    lines = []
    for section, keys in values.items():
        lines.append(f"{section}:")
        lines += [f"  {key}: {_flow(value, key in _NUMBERED)}" for key, value in keys.items()]
    return "\n".join(lines) + "\n"


_NUMBERED = ("aliases", "status_code_names")


def _flow(value: Any, numbered: bool = False) -> str:
    """YAML in one line; JSON, but for mappings whose keys are numbers."""
    if not isinstance(value, dict):
        return json.dumps(value, ensure_ascii=False)
    pairs = (
        f"{key if numbered else json.dumps(key, ensure_ascii=False)}: {_flow(one)}"
        for key, one in value.items()
    )
    return f"{{{', '.join(pairs)}}}"


def digest(config: Config) -> str:
    """Sixteen hexadecimal digits that are the same where every effective value is the same.

    The beginning of the SHA-256 of the values as JSON, keys sorted. Comments, order and
    values that stand at their default do not count; neither do a DBC file's contents.
    """
    canonical = json.dumps(effective(config), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(canonical.encode()).hexdigest()[:_DIGEST_CHARACTERS]


def schema() -> dict[str, Any]:
    """JSON Schema of the configuration file, for editors that complete and check."""
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **Config.model_json_schema(),
        "title": "vcu-gateway configuration",
    }


def core_settings(config: Config) -> Settings:
    """The core's settings, the bench demand with them."""
    values = {name: getattr(getattr(config, key.section), name) for name, key in KEYS.items()}
    demand = config.bench.demand
    return Settings(
        **values,
        tuning=tuning_of({name: getattr(config, name) for name in TUNING_SECTIONS}),
        pedals=pedals.pedals_of(config.pedals),
        bench_demand=None if demand is None else _bench_demand(demand),
    )


def _bench_demand(demand: BenchDemandSection) -> ControllerDemand:
    values = demand.model_dump(exclude={"bench_use_only", "power_mode"})
    return ControllerDemand(**values, power_mode=PowerMode[demand.power_mode.upper()])
