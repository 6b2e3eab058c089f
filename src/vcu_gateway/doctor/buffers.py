"""Receive buffer: the kernel's limits against the configured size."""

from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.doctor.check_result import CheckResult, CheckSubject
from vcu_gateway.doctor.procfs import Unreadable, number

SUBJECT = CheckSubject("buffers")
# With so much, 555 frames of a full bus of 1 Mbit/s may wait, and 380 come between two ticks.
_LEAST_BYTES = 212_992
_LIMIT = "/proc/sys/net/core/rmem_max"
_SYSCTL_FILE = "/etc/sysctl.d/60-vcu-gateway.conf"


class BufferFacts(NamedTuple):
    """Facts about buffers; `wanted_bytes` is bus.receive_buffer_bytes, None where it is not set."""

    wanted_bytes: int | None
    max_bytes: int | Unreadable


def read(wanted_bytes: int | None) -> BufferFacts:
    return BufferFacts(wanted_bytes, number(_LIMIT))


def judge(facts: BufferFacts) -> Iterator[CheckResult]:
    wanted = facts.wanted_bytes or _LEAST_BYTES
    who = "a full bus" if facts.wanted_bytes is None else "bus.receive_buffer_bytes"
    if isinstance(facts.max_bytes, Unreadable):
        yield SUBJECT.unknown("rmem_max", facts.max_bytes.reason)
    elif facts.max_bytes < wanted:
        what = f"the kernel gives {facts.max_bytes} bytes, {who} wants {wanted}"
        yield SUBJECT.warning("rmem_max", what, _set("rmem_max", wanted))
    else:
        yield SUBJECT.ok("rmem_max", f"receive buffer of {wanted} bytes is available")


def _set(name: str, value: int) -> str:
    write = f"echo net.core.{name}={value} | sudo tee -a {_SYSCTL_FILE}"
    return f"{write} && sudo sysctl -p {_SYSCTL_FILE}"
