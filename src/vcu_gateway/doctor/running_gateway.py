"""Running gateway: state and health from two requests of its API."""

import os
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway import config as configuration
from vcu_gateway.api import results
from vcu_gateway.client import Client, ClientError
from vcu_gateway.config import Config
from vcu_gateway.doctor.check_result import CheckResult, CheckSubject, Outcome, Unreadable

SUBJECT = CheckSubject("gateway")
_TIMEOUT_S = 0.5


class GatewayFacts(NamedTuple):
    """Answers of the running gateway, and the checked configuration.

    Attributes:
        answers: why and health; None where the API is switched off.
        not_permitted: this user may not open the socket.
        expected: its process is known, so it must answer.
        file, digest: of the configuration that was checked; empty where there is none.
    """

    socket_path: str
    answers: tuple[results.Why, results.Health] | Unreadable | None
    not_permitted: bool = False
    expected: bool = False
    file: str = ""
    digest: str = ""

    @property
    def pid(self) -> int | None:
        if self.answers is None or isinstance(self.answers, Unreadable):
            return None
        return self.answers[1]["pid"]


def read(config: Config, expected: bool) -> GatewayFacts:
    """Send two read-only requests, one after the other."""
    path = config.api.socket_path
    file = config.source.file
    facts = GatewayFacts(path, None, expected=expected)
    if file:
        facts = facts._replace(file=os.path.abspath(file), digest=configuration.digest(config))
    if not config.api.enabled:
        return facts
    try:
        with Client(path, timeout_s=_TIMEOUT_S) as client:
            return facts._replace(answers=(client.why(), client.health()))
    except ClientError as error:
        not_permitted = isinstance(error.__cause__, PermissionError)
        return facts._replace(answers=Unreadable(str(error)), not_permitted=not_permitted)


def judge(facts: GatewayFacts) -> Iterator[CheckResult]:
    if facts.answers is None:
        yield SUBJECT.ok("answers", "api.enabled is false: it cannot be asked")
    elif not isinstance(facts.answers, Unreadable):
        yield from _judge_answers(facts, *facts.answers)
    elif facts.not_permitted:
        yield SUBJECT.unknown("answers", facts.answers.reason)
    elif facts.expected:
        what = f"a gateway runs and does not answer: {facts.answers.reason}"
        yield SUBJECT.wrong("answers", what, "systemctl status vcu-gateway")
    else:
        yield SUBJECT.ok("answers", f"no gateway runs at {facts.socket_path}")


def _judge_answers(
    facts: GatewayFacts, why: results.Why, health: results.Health
) -> Iterator[CheckResult]:
    yield _mode(why)
    ticks, frames = health["ticks"], health["frames"]
    good = (_link(health["link"]), _skipped(ticks), _dropped(frames), _same(facts, health))
    yield from SUBJECT.summarise(f"process {health['pid']}", good)


def _mode(why: results.Why) -> CheckResult:
    sentence = why["sentence"]
    if why["mode"] == "active":
        return SUBJECT.ok("mode", f"{sentence}; it is driving: change nothing now")
    if why["mode"] == "standby":
        return SUBJECT.ok("mode", sentence)
    if why["mode"] == "fault":
        return SUBJECT.wrong("mode", sentence, "vcu-gateway reset, once the cause is gone")
    return SUBJECT.warning("mode", sentence, "vcu-gateway why")


def _link(link: results.Link) -> Outcome:
    name = f"{link['interface']} {link['channel']}"
    if link["state"] == "up":
        return f"{name} up"
    reason = f": {link['lost']}" if link["lost"] else ""
    what = f"its link to {name} is {link['state']}{reason}"
    if link["state"] == "error warning":
        return SUBJECT.warning("link", what, "see interface")
    return SUBJECT.wrong("link", what, "see interface")


def _skipped(ticks: results.Ticks) -> Outcome:
    if not ticks["skipped"]:
        return f"no tick of {ticks['done']} skipped"
    what = f"{ticks['skipped']} ticks of {ticks['done']} were skipped: the machine was too slow"
    return SUBJECT.warning("ticks", what, "see process; vcu-gateway events")


def _dropped(frames: results.FrameCounts) -> Outcome | None:
    if frames["dropped"] is None:
        return None
    if not frames["dropped"]:
        return f"no frame of {frames['received']} dropped"
    what = f"the kernel dropped {frames['dropped']} received frames of {frames['received']}"
    return SUBJECT.warning("frames", what, "see buffers and process")


def _same(facts: GatewayFacts, health: results.Health) -> Outcome | None:
    if not facts.digest:
        return None
    running = health["config_file"]
    if not _is_same(running, facts.file):
        what = f"it runs with {running}, not with {facts.file}"
        return SUBJECT.warning("config_file", what, f"vcu-gateway doctor -c {running}")
    if health["config_digest"] != facts.digest:
        what = f"{facts.file} has changed since the gateway read it"
        remedy = "vcu-gateway reload, while the vehicle stands"
        return SUBJECT.warning("config_digest", what, remedy)
    return "configuration as on disk"


def _is_same(running: str, checked: str) -> bool:
    """Whether both are the same file; the folder of a relative path is unknown."""
    if os.path.isabs(running):
        return os.path.normpath(running) == checked
    return os.path.basename(running) == os.path.basename(checked)
