"""Time: a wall clock that logs can be trusted by, and timers that are fine enough for ticks."""

import ctypes
import math
import os
import time
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.doctor.check_result import CheckResult, CheckSubject, Outcome
from vcu_gateway.doctor.procfs import Unreadable, number

SUBJECT = CheckSubject("time")
_UNSYNCHRONISED = 0x40  # STA_UNSYNC of linux/timex.h
_COARSE_NS = 1_000_000
_SLACK_AT_MOST_NS = 1_000_000
_SYNCHRONISED_BY_SYSTEMD = "/run/systemd/timesync/synchronized"


class ClockFacts(NamedTuple):
    """What was read.

    Attributes:
        synchronised: the wall clock follows a source.
        error_us: how far off the kernel takes the wall clock to be at most.
        resolution_ns: of the monotonic clock's timers.
        slack_ns: how much later than asked the kernel may wake an ordinary process.
    """

    synchronised: bool | Unreadable
    error_us: int | None
    resolution_ns: int
    slack_ns: int | Unreadable


class _Timex(ctypes.Structure):
    """The beginning of struct timex, and room for the rest."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_char * 512),
    )


def read() -> ClockFacts:
    """Ask the kernel."""
    synchronised, error_us = _wall_clock()
    return ClockFacts(
        synchronised,
        error_us,
        round(time.clock_getres(time.CLOCK_MONOTONIC) * 1e9),
        number("/proc/self/timerslack_ns"),
    )


def _wall_clock() -> tuple[bool | Unreadable, int | None]:
    told = _Timex()
    try:
        adjtimex = ctypes.CDLL(None, use_errno=True).adjtimex
    except (OSError, AttributeError) as error:
        return Unreadable(f"adjtimex: {error}"), None
    if adjtimex(ctypes.byref(told)) < 0:
        return Unreadable(f"adjtimex: {os.strerror(ctypes.get_errno())}"), None
    followed = not told.status & _UNSYNCHRONISED
    return followed or os.path.exists(_SYNCHRONISED_BY_SYSTEMD), told.maxerror


def judge(facts: ClockFacts) -> Iterator[CheckResult]:
    """What to say of it."""
    return SUBJECT.summed("", (_synchronised(facts), _resolution(facts), _slack(facts)))


def _synchronised(facts: ClockFacts) -> Outcome:
    if isinstance(facts.synchronised, Unreadable):
        return SUBJECT.unknown("synchronised", facts.synchronised.reason)
    if facts.synchronised:
        error_ms = math.ceil((facts.error_us or 0) / 1000)
        return "clock synchronised" + (f" (within {error_ms} ms)" if error_ms else "")
    what = "the wall clock is not synchronised: logs tell a wrong time; ticks do not use it"
    return SUBJECT.warning("synchronised", what, "sudo timedatectl set-ntp true")


def _resolution(facts: ClockFacts) -> Outcome:
    if facts.resolution_ns < _COARSE_NS:
        return f"timers of {facts.resolution_ns} ns"
    what = f"timers are no finer than {facts.resolution_ns / 1e6:g} ms: ticks come late"
    return SUBJECT.warning("resolution", what, "boot a kernel with high-resolution timers")


def _slack(facts: ClockFacts) -> Outcome:
    if isinstance(facts.slack_ns, Unreadable):
        return SUBJECT.unknown("slack", facts.slack_ns.reason)
    if facts.slack_ns <= _SLACK_AT_MOST_NS:
        return f"timer slack {facts.slack_ns / 1000:g} us"
    what = f"a timer slack of {facts.slack_ns / 1e6:g} ms makes ticks late"
    return SUBJECT.warning("slack", what, "remove TimerSlackNSec= from the unit or its slice")
