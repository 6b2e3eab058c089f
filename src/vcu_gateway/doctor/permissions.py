"""Permissions: rights of this user and the operators, files readable by the service's user."""

import grp
import os
import pwd
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.api.errors import Peer, Policy, Right
from vcu_gateway.config import Config, group_number, user_number
from vcu_gateway.doctor.check_result import (
    CheckResult,
    CheckSubject,
    Outcome,
    Unreadable,
    existing,
)

SUBJECT = CheckSubject("permissions")
_WORDS = {Right.READ: ("read", "stop"), Right.OPERATE: ("operate",), Right.SERVICE: ("service",)}


class Account(NamedTuple):
    """User with its number and all its groups."""

    name: str
    uid: int
    gids: frozenset[int]


class FilePermissions(NamedTuple):
    """Owner and mode of a file, folder or socket."""

    path: str
    mode: int
    uid: int
    gid: int

    def grants(self, who: Account, bits: int) -> bool:
        """Whether this user has these permission bits (4 read, 2 write, 1 enter)."""
        if who.uid == 0:
            return True
        shift = 6 if who.uid == self.uid else 3 if self.gid in who.gids else 0
        return (self.mode >> shift) & bits == bits

    @property
    def lets_all_replace(self) -> bool:
        """Whether everybody may replace the files of this folder."""
        return bool(self.mode & stat.S_IWOTH) and not self.mode & stat.S_ISVTX


def permissions_of(path: str) -> FilePermissions:
    """Owner and mode now; OSError where this user cannot see them."""
    found = os.stat(path)
    return FilePermissions(path, found.st_mode, found.st_uid, found.st_gid)


def user_name(uid: int) -> str:
    """Name of a user; the number where there is none."""
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


class PermissionFacts(NamedTuple):
    """Facts about permissions.

    Attributes:
        me: the user who runs the doctor.
        service: the gateway's own user; None where no unit is installed, Unreadable where it
            does not exist.
        policy: rights by api.* of the configuration; None where an account does not exist.
        socket_path: of the API; None where it is switched off.
        socket, folder: of the API; None where they do not exist.
        files: each file that the service reads, with all folders above it.
        has_operators: api.operator_users or api.operator_groups name somebody.
        socket_group: name of the socket's group.
        visible_folders: folders visible to the service; None where all are.
    """

    me: Account
    service: Account | Unreadable | None
    policy: Policy | None
    socket_path: str | None
    socket: FilePermissions | Unreadable | None
    folder: FilePermissions | Unreadable | None
    files: tuple[tuple[FilePermissions, ...], ...] = ()
    has_operators: bool = True
    socket_group: str = ""
    visible_folders: tuple[str, ...] | None = None


def read(
    config: Config,
    file: Path | None,
    service_user: str | None,
    visible_folders: tuple[str, ...] | None = None,
) -> PermissionFacts:
    """Read accounts and file permissions; `service_user` is None where no unit is installed."""
    api, uid = config.api, os.geteuid()
    service = None if service_user is None else _account(service_user)
    path = api.socket_path if api.enabled else None
    sock = None if path is None else existing(path, permissions_of)
    group = _group_name(sock.gid) if isinstance(sock, FilePermissions) else api.socket_group or ""
    files = [one for one in (file, config.protocol.dbc) if one is not None]
    return PermissionFacts(
        me=Account(user_name(uid), uid, frozenset({os.getegid(), *os.getgroups()})),
        service=service,
        policy=_policy(config, service),
        socket_path=path,
        socket=sock,
        folder=None if path is None else existing(os.path.dirname(path), permissions_of),
        files=tuple(tuple(_path_to(one)) for one in files),
        has_operators=bool(api.operator_users or api.operator_groups),
        socket_group=group,
        visible_folders=visible_folders,
    )


def _account(name: str) -> Account | Unreadable:
    try:
        found = pwd.getpwnam(name)
    except KeyError:
        return Unreadable(f"this machine has no user {name}")
    return Account(name, found.pw_uid, frozenset(os.getgrouplist(name, found.pw_gid)))


def _group_name(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)


def _policy(config: Config, service: Account | Unreadable | None) -> Policy | None:
    api = config.api
    try:
        return Policy(
            own_uid=service.uid if isinstance(service, Account) else os.geteuid(),
            operator_uids=frozenset(map(user_number, api.operator_users)),
            operator_gids=frozenset(map(group_number, api.operator_groups)),
            service_uids=frozenset(map(user_number, api.service_users)),
            service_gids=frozenset(map(group_number, api.service_groups)),
        )
    except KeyError:
        return None  # a result of configuration names it


def _path_to(file: Path) -> Iterator[FilePermissions]:
    """The folders above and the file, as far as this user can access them."""
    whole = file.absolute()
    for one in (*reversed(whole.parents), whole):
        place = existing(str(one), permissions_of)
        if isinstance(place, FilePermissions):
            yield place


def judge(facts: PermissionFacts) -> Iterator[CheckResult]:
    service = _service(facts)
    return SUBJECT.summarise("", (*service, _folder(facts), _operators(facts), _mine(facts)))


def _service(facts: PermissionFacts) -> Iterator[Outcome]:
    user = facts.service
    if isinstance(user, Unreadable):
        yield SUBJECT.wrong("service_user", user.reason, "sudo systemd-sysusers")
    elif user is not None:
        paths = [places for places in facts.files if places]
        results = [_file_result(user, places, facts.visible_folders) for places in paths]
        refused = [one for one in results if one]
        yield from refused
        if paths and not refused:
            yield f"{user.name} can read its files"


def _file_result(
    user: Account, places: tuple[FilePermissions, ...], visible_folders: tuple[str, ...] | None
) -> CheckResult | None:
    path = places[-1].path
    if visible_folders is not None and not any(map(Path(path).is_relative_to, visible_folders)):
        bound = " and ".join(visible_folders)
        what = f"{path} is not visible to the service: its unit binds only {bound}"
        return SUBJECT.wrong("service_files", what, "keep it in /etc/vcu-gateway")
    needed = ((one, 1 if stat.S_ISDIR(one.mode) else 4) for one in places)
    denied = next((one.path for one, bits in needed if not one.grants(user, bits)), None)
    if denied is None:
        return None
    what = f"the service's user {user.name} cannot access {denied}"
    return SUBJECT.wrong("service_files", what, f"sudo chmod o+rX {denied}")


def _folder(facts: PermissionFacts) -> Outcome | None:
    folder = facts.folder
    if isinstance(folder, Unreadable):
        return SUBJECT.unknown("folder", folder.reason)
    if folder is None:
        return _no_folder(facts)
    if folder.lets_all_replace:
        what = f"everybody may replace the API's socket: {folder.path} is open to all"
        return SUBJECT.wrong("folder", what, f"sudo chmod o-w {folder.path}")
    return None


def _no_folder(facts: PermissionFacts) -> Outcome | None:
    if facts.socket_path is None or facts.service is not None:
        return None  # the service makes its own
    folder = os.path.dirname(facts.socket_path)
    what = f"there is no folder {folder} for the API's socket; the service makes its own"
    return SUBJECT.warning("folder", what, f"sudo install -d -o {facts.me.name} {folder}")


def _operators(facts: PermissionFacts) -> Outcome | None:
    if facts.has_operators or facts.service is None or facts.socket_path is None:
        return None
    what = "only root and the gateway's own user may demand and arm"
    remedy = "name them in api.operator_groups of the configuration"
    return SUBJECT.warning("operators", what, remedy)


def _mine(facts: PermissionFacts) -> Outcome | None:
    me = facts.me
    if isinstance(facts.socket, Unreadable):
        return SUBJECT.unknown("mine", facts.socket.reason)
    if isinstance(facts.socket, FilePermissions) and not facts.socket.grants(me, 2):
        what = f"{me.name} may not open {facts.socket.path}, so neither read nor stop"
        command = f"sudo usermod -aG {facts.socket_group} {me.name}, and log in again"
        return SUBJECT.warning("mine", what, command)
    if facts.policy is None or facts.socket_path is None:
        return None
    rights = facts.policy.rights_of(Peer(0, me.uid, me.gids))
    *most, last = [word for right, words in _WORDS.items() if right in rights for word in words]
    return f"{me.name} may {', '.join(most)} and {last}"
