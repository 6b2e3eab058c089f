"""Do the configuration's users and groups exist on this machine?"""

import grp
import pwd
from collections.abc import Callable, Iterator

from vcu_gateway.config.model import Config
from vcu_gateway.errors import Problem
from vcu_gateway.strict_yaml.problems import FileProblem, problems

_USERS = ("operator_users", "service_users", "socket_owner")
_GROUPS = ("operator_groups", "service_groups", "socket_group")


def check_accounts(config: Config) -> list[Problem]:
    """Every user and group that this machine does not have; empty if good."""
    found = [
        *_unknown(config, _USERS, user_number, "user"),
        *_unknown(config, _GROUPS, group_number, "group"),
    ]
    return problems(found, config.source.file, config.source.lines)


def user_number(name: str) -> int:
    """The user's number, of its name or its number in digits; KeyError where there is none."""
    return int(name) if name.isdecimal() else pwd.getpwnam(name).pw_uid


def group_number(name: str) -> int:
    """The group's number, of its name or its number in digits; KeyError where there is none."""
    return int(name) if name.isdecimal() else grp.getgrnam(name).gr_gid


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
                remedy = f"correct it, or create it: sudo add{kind} --system {name}"
                yield FileProblem(("api", key), f"this machine has no {kind} {name}", remedy)
