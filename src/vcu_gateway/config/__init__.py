"""Configuration file: read whole, or refused with a problem for each mistake."""

from vcu_gateway.config.checks import (
    check_accounts,
    check_against,
    check_effect,
    group_number,
    user_number,
)
from vcu_gateway.config.load import (
    core_settings,
    digest,
    effective,
    load,
    of_document,
    of_values,
    parse,
    schema,
    yaml_text,
)
from vcu_gateway.config.model import BenchDemandSection, BenchSection, Config

__all__ = [
    "BenchDemandSection",
    "BenchSection",
    "Config",
    "check_accounts",
    "check_against",
    "check_effect",
    "core_settings",
    "digest",
    "effective",
    "group_number",
    "load",
    "of_document",
    "of_values",
    "parse",
    "schema",
    "user_number",
    "yaml_text",
]
