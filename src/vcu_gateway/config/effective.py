"""Effective values of a configuration, their digest, and the JSON Schema."""

import hashlib
import json
from typing import Any

from vcu_gateway.config.model import Config

_DIGEST_CHARACTERS = 16


def effective(config: Config) -> dict[str, Any]:
    """Effective values as JSON has them; identifiers as 0x and 8 digits."""
    return config.model_dump(mode="json")


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
