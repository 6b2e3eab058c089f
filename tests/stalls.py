"""Tests that failed while the machine stood still are taken again: they judged the machine.

A gateway that gets no processor for longer than half a period stops its motors, as it should, and
whatever a test expected of it is void. So a process for each processor, beside the tests and of
their rank, sleeps 10 ms at a time and tells when it woke late. A test that failed begins anew, with
all its fixtures, where one of them was late meanwhile; else, and the fifth time, it has failed.
Each is told at the end. `-p no:tests.stalls` does without.
"""

import contextlib
import os
import signal
import subprocess
import sys
import time

import pytest
from _pytest.outcomes import OutcomeException
from _pytest.runner import runtestprotocol

END_WITHIN_S = 1.0
LATE_S = 0.02  # of the watch, which sleeps 10 ms: the gateway is useless after 25 to 30
TRIES = 5  # on some machines half of all drives of 10 s are held up
TAKEN_AGAIN = "taken again"

WATCH = f"""
import os, sys, time
os.sched_setaffinity(0, [int(sys.argv[1])])
parent, before_s = os.getppid(), time.monotonic()
while os.getppid() == parent:
    time.sleep(0.01)
    now_s = time.monotonic()
    if now_s - before_s > 0.01 + {LATE_S}:
        os.write(1, b"%f %f\\n" % (before_s, now_s))
    before_s = now_s
"""


class Watch:
    """The processes that tell when the machine stood still."""

    def __init__(self) -> None:
        self._reading, writing = os.pipe()
        os.set_blocking(self._reading, False)
        self._processes = [
            subprocess.Popen(
                [sys.executable, "-I", "-S", "-c", WATCH, str(processor)],
                stdin=subprocess.DEVNULL,
                stdout=writing,
                stderr=subprocess.DEVNULL,
            )
            for processor in os.sched_getaffinity(0)
        ]
        os.close(writing)

    def longest_s(self, since_s: float) -> float:
        """The longest stall that ended since then; 0 where there was none."""
        told = b""
        try:
            while piece := os.read(self._reading, 65536):
                told += piece
        except BlockingIOError:
            pass
        stalls = [tuple(map(float, line.split())) for line in told.splitlines()]
        return max((end - begin for begin, end in stalls if end > since_s), default=0.0)

    def end(self) -> None:
        for process in self._processes:
            process.kill()
            # Beside work that starts many programs it may get no processor for minutes.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_WITHIN_S)
        os.close(self._reading)


class Stalls:
    """pytest's plugin: takes tests again, and tells which."""

    def __init__(self) -> None:
        self._watch = Watch()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool:
        hook = item.ihook
        hook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        patience = signal.getitimer(signal.ITIMER_REAL)  # pytest-timeout's
        on_timeout = signal.getsignal(signal.SIGALRM)  # which a failure takes away
        for left in reversed(range(TRIES)):
            begun_s = time.monotonic()
            reports = runtestprotocol(item, nextitem=nextitem, log=False)
            stall_s = self._watch.longest_s(begun_s)
            failed = [one for one in reports if one.failed]
            if not left or not stall_s or not failed:
                break
            crash = getattr(failed[0].longrepr, "reprcrash", None)
            reason = crash.message.partition("\n")[0] if crash else failed[0].when
            told = f"stood still for {stall_s * 1000:.0f} ms: {reason}"
            item.user_properties.append((TAKEN_AGAIN, told))
            # All fixtures anew; that one of them ends badly is of the void run, too.
            with contextlib.suppress(Exception, OutcomeException):
                item.session._setupstate.teardown_exact(None)
            signal.signal(signal.SIGALRM, on_timeout)
            signal.setitimer(signal.ITIMER_REAL, *patience)
        for one in reports:
            hook.pytest_runtest_logreport(report=one)
        hook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def pytest_unconfigure(self) -> None:
        self._watch.end()


def pytest_collection_finish(session: pytest.Session) -> None:
    """Watch where a test can be held up: the core's are calls without a clock."""
    core = session.config.rootpath / "tests" / "core"
    if any(core not in item.path.parents for item in session.items):
        session.config.pluginmanager.register(Stalls(), "stalls-watched")


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Tell what was taken again, by whichever process of pytest."""
    for report in [report for its in terminalreporter.stats.values() for report in its]:
        if getattr(report, "when", None) == "teardown":
            for told in [text for name, text in report.user_properties if name == TAKEN_AGAIN]:
                terminalreporter.write_line(f"{TAKEN_AGAIN}: {report.nodeid}: {told}")
