"""Who may read, operate and service, and whether the gateway's own user can read its files."""

import grp
import os
import pwd
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.api.rights import Peer, Policy, Right
from vcu_gateway.config import Config, group_number, user_number
from vcu_gateway.doctor.check_result import CheckResult, CheckSubject, Outcome
from vcu_gateway.doctor.procfs import Unreadable, refused

SUBJECT = CheckSubject("permissions")
_WORDS = {Right.READ: ("read", "stop"), Right.OPERATE: ("operate",), Right.SERVICE: ("service",)}


class Account(NamedTuple):
    """A user: number and every group."""

    name: str
    uid: int
    gids: frozenset[int]


class ResourcePermissions(NamedTuple):
    """A file, folder or socket with its permissions."""

    path: str
    mode: int
    uid: int
    gid: int

    def lets(self, who: Account, bits: int) -> bool:
        """Whether the permissions give this user these bits (4 read, 2 write, 1 enter)."""
        if who.uid == 0:
            return True
        shift = 6 if who.uid == self.uid else 3 if self.gid in who.gids else 0
        return (self.mode >> shift) & bits == bits


class PermissionFacts(NamedTuple):
    """What was read.

    Attributes:
        me: who asks. service: the gateway's own user; None where no unit is installed, Unread
            where it does not exist.
        policy: what api.* of the configuration says; None where an account does not exist.
        socket_path: of the API; None where it is switched off.
        socket, folder: of the API; None where they are not there.
        files: each file that the service reads, with all folders above it.
        has_operators: api.operator_users or api.operator_groups name somebody.
        socket_group: by name, for whom the socket is.
        shown: the only folders that the service sees; None where it sees all.
    """

    me: Account
    service: Account | Unreadable | None
    policy: Policy | None
    socket_path: str | None
    socket: ResourcePermissions | Unreadable | None
    folder: ResourcePermissions | Unreadable | None
    files: tuple[tuple[ResourcePermissions, ...], ...] = ()
    has_operators: bool = True
    socket_group: str = ""
    shown: tuple[str, ...] | None = None


def read(
    config: Config,
    file: Path | None,
    service_user: str | None,
    shown: tuple[str, ...] | None = None,
) -> PermissionFacts:
    """Ask the account data base and the file system; `service_user` None: no unit here."""
    api = config.api
    service = None if service_user is None else _account(service_user)
    path = api.socket_path if api.enabled else None
    sock = None if path is None else _place(path)
    group = (
        _group_name(sock.gid) if isinstance(sock, ResourcePermissions) else api.socket_group or ""
    )
    files = [one for one in (file, config.protocol.dbc) if one is not None]
    return PermissionFacts(
        me=_me(),
        service=service,
        policy=_policy(config, service),
        socket_path=path,
        socket=sock,
        folder=None if path is None else _place(os.path.dirname(path)),
        files=tuple(tuple(_way_to(one)) for one in files),
        has_operators=bool(api.operator_users or api.operator_groups),
        socket_group=group,
        shown=shown,
    )


def _me() -> Account:
    uid = os.geteuid()
    try:
        name = pwd.getpwuid(uid).pw_name
    except KeyError:
        name = str(uid)
    return Account(name, uid, frozenset({os.getegid(), *os.getgroups()}))


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
        return None  # configuration says which


def _place(path: str) -> ResourcePermissions | Unreadable | None:
    try:
        found = os.stat(path)
    except FileNotFoundError:
        return None
    except OSError as error:
        return refused(path, error)
    return ResourcePermissions(path, found.st_mode, found.st_uid, found.st_gid)


def _way_to(file: Path) -> Iterator[ResourcePermissions]:
    """The folders above and the file, as far as they can be looked at."""
    whole = file.absolute()
    for one in (*reversed(whole.parents), whole):
        place = _place(str(one))
        if isinstance(place, ResourcePermissions):
            yield place


def judge(facts: PermissionFacts) -> Iterator[CheckResult]:
    """What to say of it."""
    service = _service(facts)
    return SUBJECT.summed("", (*service, _folder(facts), _operators(facts), _mine(facts)))


def _service(facts: PermissionFacts) -> Iterator[Outcome]:
    user = facts.service
    if isinstance(user, Unreadable):
        yield SUBJECT.wrong("service_user", user.reason, "sudo systemd-sysusers")
    elif user is not None:
        ways = [way for way in facts.files if way]
        told = [one for way in ways if (one := _way(user, way, facts.shown))]
        yield from told
        if ways and not told:
            yield f"{user.name} can read its files"


def _way(
    user: Account, way: tuple[ResourcePermissions, ...], shown: tuple[str, ...] | None
) -> CheckResult | None:
    path = way[-1].path
    if shown is not None and not any(Path(path).is_relative_to(folder) for folder in shown):
        what = f"the service does not see {path}: its unit shows it {' and '.join(shown)} alone"
        return SUBJECT.wrong("service_files", what, "keep it in /etc/vcu-gateway")
    barrier = _barrier(user, way)
    if barrier is None:
        return None
    what = f"the service's user {user.name} cannot get to {barrier}"
    return SUBJECT.wrong("service_files", what, f"sudo chmod o+rX {barrier}")


def _barrier(user: Account, way: tuple[ResourcePermissions, ...]) -> str | None:
    """The first place on the way that does not let this user through."""
    for place in way:
        needed = 1 if stat.S_ISDIR(place.mode) else 4
        if not place.lets(user, needed):
            return place.path
    return None


def _folder(facts: PermissionFacts) -> Outcome | None:
    folder = facts.folder
    if isinstance(folder, Unreadable):
        return SUBJECT.unknown("folder", folder.reason)
    if folder is None:
        return _no_folder(facts)
    if folder.mode & stat.S_IWOTH and not folder.mode & stat.S_ISVTX:
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
    what = "nobody but root and the gateway's own user may demand and arm"
    return SUBJECT.warning(
        "operators", what, "name them in api.operator_groups of the configuration"
    )


def _mine(facts: PermissionFacts) -> Outcome | None:
    me = facts.me
    if isinstance(facts.socket, Unreadable):
        return SUBJECT.unknown("mine", facts.socket.reason)
    if isinstance(facts.socket, ResourcePermissions) and not facts.socket.lets(me, 2):
        what = f"{me.name} may not open {facts.socket.path}, so neither read nor stop"
        command = f"sudo usermod -aG {facts.socket_group} {me.name}, and log in again"
        return SUBJECT.warning("mine", what, command)
    if facts.policy is None or facts.socket_path is None:
        return None
    rights = facts.policy.rights_of(Peer(0, me.uid, me.gids))
    *most, last = [word for right, words in _WORDS.items() if right in rights for word in words]
    return f"{me.name} may {', '.join(most)} and {last}"
