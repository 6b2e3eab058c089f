"""Checks of a configuration: its protocol, this machine's accounts, effect; all before a start."""

import dataclasses
import grp
import pwd
from collections.abc import Callable, Iterator
from pathlib import Path

from vcu_gateway.config import pedals
from vcu_gateway.config.load import core_settings, load
from vcu_gateway.config.model import IDENTIFIER_KEYS, Config
from vcu_gateway.config.tuning import without_effect
from vcu_gateway.core import j1939
from vcu_gateway.core.receive import OWN_NODE
from vcu_gateway.core.settings import KEYS
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.core.state import deadlines
from vcu_gateway.errors import ConfigError, DataError, Problem, did_you_mean
from vcu_gateway.protocol import dbc, packaged
from vcu_gateway.strict_yaml.file_text import FileProblem, problems
from vcu_gateway.units import NS_PER_MS

_PATIENCE = 2  # times its default, for a required message
_SWITCH_OFF = "this alias is the default; write `aliases: {}` for none"


def check_against(config: Config, protocol: ProtocolSpec) -> list[Problem]:
    """Problems of the messages that the configuration names; empty where there are none."""
    found = [
        *_aliases(config, protocol),
        *_freshness(config, protocol),
        *_patience(config, protocol),
        *_required(config, protocol),
        *pedals.check_message(config.pedals, protocol, ttl_max_ms=config.demand.ttl_max_ms),
    ]
    return problems(found, config.source.file, config.source.lines, IDENTIFIER_KEYS)


def _aliases(config: Config, protocol: ProtocolSpec) -> Iterator[FileProblem]:
    names = [message.name for message in protocol.messages]
    taken = {j1939.match_key(message.can_id): message.name for message in protocol.messages}
    for identifier, name in config.protocol.aliases.items():
        path = ("protocol", "aliases", identifier)
        key = j1939.match_key(identifier)
        if name not in names:
            is_default = "aliases" not in config.protocol.model_fields_set
            remedy = _SWITCH_OFF if is_default else _nearest(name, names)
            yield FileProblem(path, _no_message(name), remedy)
        elif key in taken:
            what = f"stands for {taken[key]} already (the priority does not count)"
            yield FileProblem(path, what, "remove it")
        taken.setdefault(key, name)


def _freshness(config: Config, protocol: ProtocolSpec) -> Iterator[FileProblem]:
    messages = {message.name: message for message in protocol.messages}
    stale_after_ms = config.freshness.stale_after_ms
    late_after_ms = config.freshness.late_after_ms
    for key, ages_ms in (("stale_after_ms", stale_after_ms), ("late_after_ms", late_after_ms)):
        for name in ages_ms.keys() - messages.keys():
            path = ("freshness", key, name)
            yield FileProblem(path, _no_message(name), _nearest(name, list(messages)))
    for name in late_after_ms.keys() & messages.keys():
        stale_ns = deadlines(messages[name], {}, stale_after_ms).stale_after_ns
        if late_after_ms[name] * NS_PER_MS > stale_ns:
            what = f"must be at most {stale_ns // NS_PER_MS} ms, not {late_after_ms[name]}"
            remedy = f"{name} is stale by then"
            yield FileProblem(("freshness", "late_after_ms", name), what, remedy)


def _patience(config: Config, protocol: ProtocolSpec) -> Iterator[FileProblem]:
    """A required message may be waited for at most twice as long as its period says."""
    for message in protocol.received_by(OWN_NODE):
        if message.name not in config.safety.required_messages:
            continue
        default = deadlines(message, {}, {})
        for key, ages_ms, default_ns in (
            ("stale_after_ms", config.freshness.stale_after_ms, default.stale_after_ns),
            ("late_after_ms", config.freshness.late_after_ms, default.late_after_ns),
        ):
            age_ms, most_ms = ages_ms.get(message.name), _PATIENCE * default_ns // NS_PER_MS
            if age_ms is not None and age_ms > most_ms:
                what = f"must be at most {most_ms} ms, not {age_ms}"
                remedy = f"{message.name} is required: at most twice its default"
                yield FileProblem(("freshness", key, message.name), what, remedy)


def _required(config: Config, protocol: ProtocolSpec) -> Iterator[FileProblem]:
    names = [message.name for message in protocol.received_by(OWN_NODE)]
    for index, name in enumerate(config.safety.required_messages):
        if name not in names:
            path = ("safety", "required_messages", index)
            yield FileProblem(
                path, f'the gateway receives no message "{name}"', _nearest(name, names)
            )


def _no_message(name: str) -> str:
    return f'the protocol has no message "{name}"'


def _nearest(name: str, names: list[str]) -> str:
    return did_you_mean(name, names) or f"its messages are {', '.join(names)}"


_USERS = ("operator_users", "service_users", "socket_owner")
_GROUPS = ("operator_groups", "service_groups", "socket_group")
_HIGHEST_NUMBER = 2**32 - 2  # of a user or a group; one more means "leave it as it is"


def check_accounts(config: Config) -> list[Problem]:
    """Problems of users and groups that this machine does not have; empty where there are none."""
    found = [
        *_unknown(config, _USERS, user_number, "user"),
        *_unknown(config, _GROUPS, group_number, "group"),
    ]
    return problems(found, config.source.file, config.source.lines, IDENTIFIER_KEYS)


def user_number(name: str) -> int:
    """User number of a name, or of a number in digits; KeyError where there is none."""
    return _number(name) if name.isdecimal() else pwd.getpwnam(name).pw_uid


def group_number(name: str) -> int:
    """Group number of a name, or of a number in digits; KeyError where there is none."""
    return _number(name) if name.isdecimal() else grp.getgrnam(name).gr_gid


def _number(digits: str) -> int:
    if int(digits) > _HIGHEST_NUMBER:
        raise KeyError(digits)
    return int(digits)


def _unknown(
    config: Config, keys: tuple[str, ...], number_of: Callable[[str], int], kind: str
) -> Iterator[FileProblem]:
    for key in keys:
        value = getattr(config.api, key)
        names = (value,) if isinstance(value, str) else value or ()
        for name in names:
            try:
                number_of(name)
            except KeyError:
                create = (
                    "" if name.isdecimal() else f", or create it: sudo add{kind} --system {name}"
                )
                remedy = f"correct it{create}"
                yield FileProblem(("api", key), f"this machine has no {kind} {name}", remedy)


def check_effect(config: Config) -> list[Problem]:
    """Values that are allowed, and lack an effect or a watch; they prevent no start."""
    source, limits = config.source, config.limits
    highest = {
        "power_limit_w": limits.power_limit_max_w,
        "brake_pct": 100,
        "speed_limit_rpm": limits.speed_limit_max_rpm,
    }
    hints = [*without_effect(core_settings(config).tuning, highest), *pedals.hints(config.pedals)]
    found = problems(hints, source.file, source.lines, IDENTIFIER_KEYS)
    return [*_too_high(config), *found]


def _too_high(config: Config) -> Iterator[Problem]:
    """Values that do not lie below the one that they are to lower."""
    for name, key in KEYS.items():
        if key.below is None:
            continue
        section = getattr(config, key.section)
        value, most = getattr(section, name), getattr(section, key.below)
        if 0 < most <= value:
            path = (key.section, name if name in section.model_fields_set else key.below)
            what = (
                f"{key.section}.{name} has no effect: it is {value},"
                f" {key.section}.{key.below} is {most}"
            )
            remedy = f"set it below that, as in {name}: {most // 2}"
            yield Problem(what, config.source.lines.where(config.source.file, path), remedy)


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
    if found := found or dbc.unmet(protocol, lambda *_: where):
        raise DataError(*found[:_MOST_PROBLEMS])


def _differences(protocol: ProtocolSpec, where: str) -> list[Problem]:
    remedy = f"`protocol.dbc` may add to the packaged DBC, not change it; {dbc.REMEDY}"
    reference = dbc.load(packaged("vcu.dbc"))
    return [Problem(what, where, remedy) for what in dbc.differences(protocol, reference)]
