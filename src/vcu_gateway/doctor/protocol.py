"""DBC in use: readable and compatible with the safety rules."""

from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway import config as configuration
from vcu_gateway.config import Config
from vcu_gateway.core.spec import ProtocolSpec
from vcu_gateway.doctor.check_result import CheckResult, CheckSubject
from vcu_gateway.errors import GatewayError, Problem

SUBJECT = CheckSubject("protocol")


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


def read(config: Config) -> ProtocolFacts:
    """Read it as the gateway does; cantools is imported only here."""
    from vcu_gateway.config.protocol import check_protocol, load_protocol

    facts = ProtocolFacts(None if config.protocol.dbc is None else str(config.protocol.dbc))
    try:
        spec = load_protocol(config)
        facts = facts._replace(spec=spec)
        check_protocol(config, spec)
    except GatewayError as error:
        return facts._replace(contradictions=error.problems)
    return facts._replace(unknown_names=tuple(configuration.check_against(config, spec)))


def judge(facts: ProtocolFacts) -> Iterator[CheckResult]:
    for problem in facts.contradictions:
        yield SUBJECT.problem("dbc", problem)
    for problem in facts.unknown_names:
        yield SUBJECT.problem("names", problem)
    if facts.spec is not None and not facts.contradictions:
        which = facts.file or "the packaged DBC"
        messages = len(facts.spec.messages)
        yield SUBJECT.ok("dbc", f"{which}: {messages} messages, compatible with the safety rules")
