"""The configuration file: read whole or refused, with a reason for each thing wrong."""

from vcu_gateway.config.accounts import check_accounts, group_number, user_number
from vcu_gateway.config.checks import check_against
from vcu_gateway.config.effective import digest, effective, schema
from vcu_gateway.config.load import load, parse
from vcu_gateway.config.machine import Api, Bus, Freshness, Log, Protocol
from vcu_gateway.config.model import Config
from vcu_gateway.config.vehicle import (
    BenchDemandSection,
    BenchSection,
    DemandSection,
    LimitsSection,
    SafetySection,
)

__all__ = [
    "Api",
    "BenchDemandSection",
    "BenchSection",
    "Bus",
    "Config",
    "DemandSection",
    "Freshness",
    "LimitsSection",
    "Log",
    "Protocol",
    "SafetySection",
    "check_accounts",
    "check_against",
    "digest",
    "effective",
    "group_number",
    "load",
    "parse",
    "schema",
    "user_number",
]
