"""Configuration file: found, valid, writable only by its owner; the DBC in use."""

import os
import shlex
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from vcu_gateway import config as configuration
from vcu_gateway.config import Config
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.doctor.check_result import CheckResult, CheckSubject, Unreadable
from vcu_gateway.doctor.permissions import FilePermissions, permissions_of, user_name
from vcu_gateway.errors import GatewayError, Problem

SUBJECT = CheckSubject("configuration")
PROTOCOL = CheckSubject("protocol")
_ROOT = 0


class ConfigurationFacts(NamedTuple):
    """Facts about the configuration file.

    Attributes:
        path: None where no file was found.
        config: None where there is no valid one.
        problems: as check-config reports them.
        accounts: users and groups that it names and this machine does not have.
        unread: why this user cannot read it; None where it can.
        own_uid: this user.
    """

    path: Path | None
    config: Config | None = None
    problems: tuple[Problem, ...] = ()
    accounts: tuple[Problem, ...] = ()
    unread: Unreadable | None = None
    file: FilePermissions | None = None
    folder: FilePermissions | None = None
    owner: str = ""
    own_uid: int = _ROOT

    @property
    def can_be_checked(self) -> bool:
        """Whether the machine can be checked against it, or against the defaults without a file."""
        return self.config is not None or self.path is None

    @property
    def in_effect(self) -> Config:
        return self.config or Config()


def read(path: Path | None, missing: tuple[Problem, ...] = ()) -> ConfigurationFacts:
    if path is None:
        return ConfigurationFacts(None, problems=missing)
    facts = ConfigurationFacts(path, own_uid=os.geteuid())
    try:
        file = permissions_of(str(path))
        folder = permissions_of(str(path.absolute().parent))
        facts = facts._replace(file=file, folder=folder, owner=user_name(file.uid))
    except PermissionError as error:
        return facts._replace(unread=Unreadable(f"this user may not access it: {error.strerror}"))
    except OSError as error:
        return facts._replace(problems=(Problem(error.strerror or str(error), str(path)),))
    if not os.access(path, os.R_OK):
        return facts._replace(unread=Unreadable("this user may not read it"))
    try:
        config = configuration.load(path)
    except GatewayError as error:
        return facts._replace(problems=error.problems)
    return facts._replace(config=config, accounts=tuple(configuration.check_accounts(config)))


def judge(facts: ConfigurationFacts) -> Iterator[CheckResult]:
    if facts.unread is not None:
        what = f"{facts.path}: {facts.unread.reason}"
        yield SUBJECT.unknown("readable", what, "sudo vcu-gateway doctor")
    for problem in facts.problems:
        yield SUBJECT.problem("valid", problem)
    if facts.path is None:
        yield SUBJECT.ok("defaults", "the following checks use the default of every key")
    elif facts.config is None:
        what = "protocol, interface, permissions and buffers need a valid configuration"
        yield SUBJECT.unknown("dependent", what)
    if facts.config is not None:
        digest = configuration.digest(facts.config)
        yield SUBJECT.ok("valid", f"{facts.path}: valid, digest {digest}")
        yield from _doubtful(facts.path, facts.config)
    for problem in facts.accounts:
        yield SUBJECT.problem("accounts", problem)
    if facts.path is not None and facts.file is not None:
        yield from _permissions(facts, str(facts.path), facts.file)


def _doubtful(path: Path | None, config: Config) -> Iterator[CheckResult]:
    for problem in configuration.check_effect(config):
        yield SUBJECT.warning("effect", f"{problem.where}: {problem.what}", problem.remedy)
    if config.bench.demand is None:
        return
    what = f"{path}: a static demand, which never expires: for a test bench only"
    yield SUBJECT.warning("bench", what, "in a vehicle, remove the section bench")


def _permissions(
    facts: ConfigurationFacts, path: str, file: FilePermissions
) -> Iterator[CheckResult]:
    quoted = shlex.quote(path)
    if file.mode & stat.S_IWOTH:
        yield SUBJECT.wrong("mode", f"{path}: everybody may change it", f"sudo chmod o-w {quoted}")
    if file.mode & stat.S_IWGRP and file.gid != _ROOT:
        what = f"{path}: its group may change it"
        yield SUBJECT.warning("group", what, f"sudo chmod g-w {quoted}")
    if file.uid not in (_ROOT, facts.own_uid):
        what = f"{path} belongs to {facts.owner}, who may change every limit in it"
        yield SUBJECT.warning("owner", what, f"sudo chown root: {quoted}")
    if facts.folder is not None and facts.folder.lets_all_replace:
        parent = shlex.quote(os.path.dirname(os.path.abspath(path)))
        what = f"{path} may be replaced by everybody: its folder is open to all"
        yield SUBJECT.wrong("folder", what, f"sudo chmod o-w {parent}")


class ProtocolFacts(NamedTuple):
    """Facts about the protocol.

    Attributes:
        file: the configured DBC; None is the packaged one.
        spec: None where it cannot be read.
        contradictions: with the protocol of the safety rules.
        unknown_names: messages of the configuration that the protocol does not have.
    """

    file: str | None
    spec: ProtocolSpec | None = None
    contradictions: tuple[Problem, ...] = ()
    unknown_names: tuple[Problem, ...] = ()


def read_protocol(config: Config) -> ProtocolFacts:
    """Read it as the gateway does; cantools is imported only here."""
    from vcu_gateway.config.checks import check_protocol, load_protocol

    facts = ProtocolFacts(None if config.protocol.dbc is None else str(config.protocol.dbc))
    try:
        spec = load_protocol(config)
        facts = facts._replace(spec=spec)
        check_protocol(config, spec)
    except GatewayError as error:
        return facts._replace(contradictions=error.problems)
    return facts._replace(unknown_names=tuple(configuration.check_against(config, spec)))


def judge_protocol(facts: ProtocolFacts) -> Iterator[CheckResult]:
    for problem in facts.contradictions:
        yield PROTOCOL.problem("dbc", problem)
    for problem in facts.unknown_names:
        yield PROTOCOL.problem("names", problem)
    if facts.spec is not None and not facts.contradictions:
        which = facts.file or "the packaged DBC"
        messages = len(facts.spec.messages)
        yield PROTOCOL.ok("dbc", f"{which}: {messages} messages, compatible with the safety rules")
