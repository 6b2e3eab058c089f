"""Time: a wall clock that logs can be trusted by, and timers that are fine enough for ticks."""

import ctypes
import math
import os
import time
from collections.abc import Iterator
from typing import NamedTuple

from vcu_gateway.doctor.check_result import Finding, Subject, Told
from vcu_gateway.doctor.procfs import Unread, number

SAY = Subject("time")
_UNSYNCHRONISED = 0x40  # STA_UNSYNC of linux/timex.h
_COARSE_NS = 1_000_000
_SLACK_AT_MOST_NS = 1_000_000
_SYNCHRONISED_BY_SYSTEMD = "/run/systemd/timesync/synchronized"


class Facts(NamedTuple):
    """What was read.

    Attributes:
        synchronised: the wall clock follows a source.
        error_us: how far off the kernel takes the wall clock to be at most.
        resolution_ns: of the monotonic clock's timers.
        slack_ns: how much later than asked the kernel may wake an ordinary process.
    """

    synchronised: bool | Unread
    error_us: int | None
    resolution_ns: int
    slack_ns: int | Unread


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


def read() -> Facts:
    """Ask the kernel."""
    synchronised, error_us = _wall_clock()
    return Facts(
        synchronised,
        error_us,
        round(time.clock_getres(time.CLOCK_MONOTONIC) * 1e9),
        number("/proc/self/timerslack_ns"),
    )


def _wall_clock() -> tuple[bool | Unread, int | None]:
    told = _Timex()
    try:
        adjtimex = ctypes.CDLL(None, use_errno=True).adjtimex
    except (OSError, AttributeError) as error:
        return Unread(f"adjtimex: {error}"), None
    if adjtimex(ctypes.byref(told)) < 0:
        return Unread(f"adjtimex: {os.strerror(ctypes.get_errno())}"), None
    followed = not told.status & _UNSYNCHRONISED
    return followed or os.path.exists(_SYNCHRONISED_BY_SYSTEMD), told.maxerror


def judge(facts: Facts) -> Iterator[Finding]:
    """What to say of it."""
    return SAY.summed("", (_synchronised(facts), _resolution(facts), _slack(facts)))


def _synchronised(facts: Facts) -> Told:
    if isinstance(facts.synchronised, Unread):
        return SAY.unknown("synchronised", facts.synchronised.reason)
    if facts.synchronised:
        error_ms = math.ceil((facts.error_us or 0) / 1000)
        return "clock synchronised" + (f" (within {error_ms} ms)" if error_ms else "")
    what = "the wall clock is not synchronised: logs tell a wrong time; ticks do not use it"
    return SAY.warning("synchronised", what, "sudo timedatectl set-ntp true")


def _resolution(facts: Facts) -> Told:
    if facts.resolution_ns < _COARSE_NS:
        return f"timers of {facts.resolution_ns} ns"
    what = f"timers are no finer than {facts.resolution_ns / 1e6:g} ms: ticks come late"
    return SAY.warning("resolution", what, "boot a kernel with high-resolution timers")


def _slack(facts: Facts) -> Told:
    if isinstance(facts.slack_ns, Unread):
        return SAY.unknown("slack", facts.slack_ns.reason)
    if facts.slack_ns <= _SLACK_AT_MOST_NS:
        return f"timer slack {facts.slack_ns / 1000:g} us"
    what = f"a timer slack of {facts.slack_ns / 1e6:g} ms makes ticks late"
    return SAY.warning("slack", what, "remove TimerSlackNSec= from the unit or its slice")
