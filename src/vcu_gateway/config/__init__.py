"""Configuration file: read whole, or refused with a problem for each mistake."""

from vcu_gateway.config.checks import (
    check_accounts,
    check_against,
    check_effect,
    group_number,
    user_number,
)
from vcu_gateway.config.core_settings import core_settings
from vcu_gateway.config.effective import digest, effective, schema, yaml_text
from vcu_gateway.config.load import load, of_values, parse
from vcu_gateway.config.model import Config
from vcu_gateway.config.vehicle import BenchDemandSection, BenchSection

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
    "of_values",
    "parse",
    "schema",
    "user_number",
    "yaml_text",
]
