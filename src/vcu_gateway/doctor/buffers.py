"""Receive buffer: the kernel's limits against the configured size."""

from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.doctor.check_result import CheckResult, CheckSubject
from vcu_gateway.doctor.procfs import Unreadable, number

SUBJECT = CheckSubject("buffers")
# The kernel's usual default. On a saturated bus of 1 Mbit/s half of it gathers between two reads.
_LEAST_DEFAULT_BYTES = 212_992
_FOLDER = "/proc/sys/net/core"
_SYSCTL_FILE = "/etc/sysctl.d/60-vcu-gateway.conf"


class BufferFacts(NamedTuple):
    """Facts about buffers; `wanted_bytes` is bus.receive_buffer_bytes, None is the kernel's own."""

    wanted_bytes: int | None
    max_bytes: int | Unreadable
    default_bytes: int | Unreadable


def read(wanted_bytes: int | None) -> BufferFacts:
    """Read them from the kernel."""
    return BufferFacts(
        wanted_bytes, number(f"{_FOLDER}/rmem_max"), number(f"{_FOLDER}/rmem_default")
    )


def judge(facts: BufferFacts) -> Iterator[CheckResult]:
    """Judge the receive buffer."""
    wanted = facts.wanted_bytes
    if wanted is None:
        yield _usual(facts.default_bytes)
    elif isinstance(facts.max_bytes, Unreadable):
        yield SUBJECT.unknown("rmem_max", facts.max_bytes.reason)
    elif facts.max_bytes < wanted:
        what = f"the kernel gives {facts.max_bytes} bytes, bus.receive_buffer_bytes wants {wanted}"
        yield SUBJECT.warning("rmem_max", what, _set("rmem_max", wanted))
    else:
        yield SUBJECT.ok("rmem_max", f"receive buffer of {wanted} bytes is available")


def _usual(default_bytes: int | Unreadable) -> CheckResult:
    if isinstance(default_bytes, Unreadable):
        return SUBJECT.unknown("rmem_default", default_bytes.reason)
    if default_bytes < _LEAST_DEFAULT_BYTES:
        what = f"a receive buffer of {default_bytes} bytes may overflow on a full bus"
        return SUBJECT.warning("rmem_default", what, _set("rmem_default", _LEAST_DEFAULT_BYTES))
    return SUBJECT.ok("rmem_default", f"receive buffer of {default_bytes} bytes, the kernel's own")


def _set(name: str, value: int) -> str:
    write = f"echo net.core.{name}={value} | sudo tee -a {_SYSCTL_FILE}"
    return f"{write} && sudo sysctl -p {_SYSCTL_FILE}"
