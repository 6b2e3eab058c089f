"""Protocol that a configuration names, and every check before a start.

The packaged DBC, or another one that agrees with it.
"""

import dataclasses
from pathlib import Path

from vcu_gateway.config.checks import check_accounts, check_against
from vcu_gateway.config.load import load
from vcu_gateway.config.model import Config
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.errors import ConfigError, DataError, Problem
from vcu_gateway.protocol import dbc, packaged, requirements

_MOST_PROBLEMS = 20


def startable(path: Path, *, on_this_machine: bool = True) -> tuple[Config, ProtocolSpec]:
    """Configuration and protocol of a start, after every check that a start makes.

    `run` and `check-config` both call it. Without `on_this_machine` the users and groups are not
    looked up: the file is for another machine. Raises ConfigError, DataError or MissingInputError
    where the gateway would not start.
    """
    config = load(path)
    protocol = load_protocol(config)
    check_protocol(config, protocol)
    found = check_against(config, protocol) + (check_accounts(config) if on_this_machine else [])
    if found:
        raise ConfigError(*found)
    return config, protocol


def load_protocol(config: Config) -> ProtocolSpec:
    """The configured DBC, or the packaged one, with the configured aliases."""
    return dataclasses.replace(dbc.load(dbc_path(config)), aliases=config.protocol.aliases)


def dbc_path(config: Config) -> Path:
    return packaged("vcu.dbc") if config.protocol.dbc is None else config.protocol.dbc


def check_protocol(config: Config, protocol: ProtocolSpec) -> None:
    """DataError where the gateway cannot run with this protocol.

    A configured DBC must agree with the packaged one besides.
    """
    where = str(dbc_path(config))
    found = [] if config.protocol.dbc is None else _differences(protocol, where)
    if found := found or requirements.unmet(protocol, lambda *_: where):
        raise DataError(*found[:_MOST_PROBLEMS])


def _differences(protocol: ProtocolSpec, where: str) -> list[Problem]:
    remedy = f"`protocol.dbc` may add to the packaged DBC, not change it; {requirements.REMEDY}"
    reference = dbc.load(packaged("vcu.dbc"))
    return [Problem(what, where, remedy) for what in requirements.differences(protocol, reference)]
