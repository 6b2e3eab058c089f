"""Clocks: wall clock synchronised, timers fine enough for the ticks."""

import ctypes
import math
import os
import time
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.doctor.check_result import CheckResult, CheckSubject, Outcome, Unreadable, number
from vcu_gateway.units import NS_PER_MS, NS_PER_S

SUBJECT = CheckSubject("time")
_UNSYNCHRONISED = 0x40  # STA_UNSYNC of linux/timex.h
_COARSE_NS = 1_000_000
_SLACK_AT_MOST_NS = 1_000_000
_SYNCHRONISED_BY_SYSTEMD = "/run/systemd/timesync/synchronized"


class ClockFacts(NamedTuple):
    """Facts about clocks and timers.

    Attributes:
        synchronised: the wall clock follows a time source.
        error_us: the kernel's largest estimated error of the wall clock.
        resolution_ns: of the monotonic clock's timers.
        slack_ns: timer slack of an ordinary process.
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
    synchronised, error_us = _wall_clock()
    return ClockFacts(
        synchronised,
        error_us,
        round(time.clock_getres(time.CLOCK_MONOTONIC) * NS_PER_S),
        number("/proc/self/timerslack_ns"),
    )


def _wall_clock() -> tuple[bool | Unreadable, int | None]:
    timex = _Timex()
    try:
        adjtimex = ctypes.CDLL(None, use_errno=True).adjtimex
    except (OSError, AttributeError) as error:
        return Unreadable(f"adjtimex: {error}"), None
    if adjtimex(ctypes.byref(timex)) < 0:
        return Unreadable(f"adjtimex: {os.strerror(ctypes.get_errno())}"), None
    followed = not timex.status & _UNSYNCHRONISED
    return followed or os.path.exists(_SYNCHRONISED_BY_SYSTEMD), timex.maxerror


def judge(facts: ClockFacts) -> Iterator[CheckResult]:
    return SUBJECT.summarise("", (_synchronised(facts), _resolution(facts), _slack(facts)))


def _synchronised(facts: ClockFacts) -> Outcome:
    if isinstance(facts.synchronised, Unreadable):
        return SUBJECT.unknown("synchronised", facts.synchronised.reason)
    if facts.synchronised:
        error_ms = math.ceil((facts.error_us or 0) / 1000)
        return "clock synchronised" + (f" (within {error_ms} ms)" if error_ms else "")
    what = "the wall clock is not synchronised: logs have a wrong time; ticks do not use it"
    return SUBJECT.warning("synchronised", what, "sudo timedatectl set-ntp true")


def _resolution(facts: ClockFacts) -> Outcome:
    if facts.resolution_ns < _COARSE_NS:
        return f"timers of {facts.resolution_ns} ns"
    what = f"timers are no finer than {facts.resolution_ns / NS_PER_MS:g} ms: ticks come late"
    return SUBJECT.warning("resolution", what, "boot a kernel with high-resolution timers")


def _slack(facts: ClockFacts) -> Outcome:
    if isinstance(facts.slack_ns, Unreadable):
        return SUBJECT.unknown("slack", facts.slack_ns.reason)
    if facts.slack_ns <= _SLACK_AT_MOST_NS:
        return f"timer slack {facts.slack_ns / 1000:g} us"
    what = f"a timer slack of {facts.slack_ns / NS_PER_MS:g} ms makes ticks late"
    return SUBJECT.warning("slack", what, "remove TimerSlackNSec= from the unit or its slice")
