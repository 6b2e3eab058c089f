"""The kernel's limits on receive buffers, against what the configuration asks for."""

from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.doctor.check_result import CheckResult, CheckSubject
from vcu_gateway.doctor.procfs import Unreadable, number

SUBJECT = CheckSubject("buffers")
# The kernel's usual value. On a saturated bus of 1 Mbit/s half of it gathers between two readings.
_USUAL_BYTES = 212_992
_FOLDER = "/proc/sys/net/core"
_KEPT_IN = "/etc/sysctl.d/60-vcu-gateway.conf"


class BufferFacts(NamedTuple):
    """What was read; `asked_bytes` is bus.receive_buffer_bytes, None leaves it to the kernel."""

    asked_bytes: int | None
    largest_bytes: int | Unreadable
    usual_bytes: int | Unreadable


def read(asked_bytes: int | None) -> BufferFacts:
    """Ask the kernel."""
    return BufferFacts(
        asked_bytes, number(f"{_FOLDER}/rmem_max"), number(f"{_FOLDER}/rmem_default")
    )


def judge(facts: BufferFacts) -> Iterator[CheckResult]:
    """What to say of it."""
    asked = facts.asked_bytes
    if asked is None:
        yield _usual(facts.usual_bytes)
    elif isinstance(facts.largest_bytes, Unreadable):
        yield SUBJECT.unknown("rmem_max", facts.largest_bytes.reason)
    elif facts.largest_bytes < asked:
        what = (
            f"the kernel gives {facts.largest_bytes} bytes, bus.receive_buffer_bytes asks {asked}"
        )
        yield SUBJECT.warning("rmem_max", what, _set("rmem_max", asked))
    else:
        yield SUBJECT.ok("rmem_max", f"receive buffer of {asked} bytes can be had")


def _usual(usual_bytes: int | Unreadable) -> CheckResult:
    if isinstance(usual_bytes, Unreadable):
        return SUBJECT.unknown("rmem_default", usual_bytes.reason)
    if usual_bytes < _USUAL_BYTES:
        what = f"a receive buffer of {usual_bytes} bytes may overflow on a full bus"
        return SUBJECT.warning("rmem_default", what, _set("rmem_default", _USUAL_BYTES))
    return SUBJECT.ok("rmem_default", f"receive buffer of {usual_bytes} bytes, the kernel's own")


def _set(name: str, value: int) -> str:
    return f"echo net.core.{name}={value} | sudo tee -a {_KEPT_IN} && sudo sysctl -p {_KEPT_IN}"
