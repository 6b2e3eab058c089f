"""Effective values of a configuration, their digest, and the JSON Schema."""

import hashlib
import json
from typing import Any

from vcu_gateway.config.model import Config

_DIGEST_CHARACTERS = 16


def effective(config: Config) -> dict[str, Any]:
    """Effective values as JSON has them; identifiers as 0x and 8 digits."""
    return config.model_dump(mode="json")


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
