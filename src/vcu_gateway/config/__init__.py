"""The configuration file: read whole or refused, with a reason for each thing wrong."""

from vcu_gateway.config.load import load, parse
from vcu_gateway.config.model import (
    Bench,
    BenchDemand,
    Bus,
    Config,
    Demand,
    Freshness,
    Limits,
    Log,
    Protocol,
    Safety,
)
from vcu_gateway.config.names import check_against
from vcu_gateway.config.values import digest, effective, schema

__all__ = [
    "Bench",
    "BenchDemand",
    "Bus",
    "Config",
    "Demand",
    "Freshness",
    "Limits",
    "Log",
    "Protocol",
    "Safety",
    "check_against",
    "digest",
    "effective",
    "load",
    "parse",
    "schema",
]
