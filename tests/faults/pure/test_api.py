"""The API abused, and its operators gone wrong, while the vehicle drives."""

import contextlib
import itertools
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.driven import Driven, driven, wait_until
from tests.faults.conftest import ROOT, Seen
from tests.faults.line_client import LineClient
from tests.faults.machine import resident_kb
from tests.faults.pure.bystander import PATIENCE_S, bystander, once_more
from tests.faults.pure.test_process import let_go, moving

MS = 1_000_000
TTL_MS = 200
PERIOD_MS = 50
LEEWAY_MS = 150  # what a busy machine may take to notice the end of a connection


@contextlib.contextmanager
def connected(path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX) as one:
        one.settimeout(PATIENCE_S)
        one.connect(str(path))
        yield one


def answer(one: socket.socket) -> dict:
    """The next line; {} where the connection was ended instead."""
    try:
        line = one.makefile("rb").readline()
    except ConnectionError:
        return {}
    return json.loads(line) if line else {}


def connect_and_go(path: Path) -> str:
    for _ in range(2000):
        try:
            with socket.socket(socket.AF_UNIX) as one:
                one.setblocking(False)
                one.connect(str(path))
        except BlockingIOError:  # the backlog is full
            time.sleep(0.0005)
    return "2000 connections opened and dropped"


def half_open(path: Path) -> str:
    with contextlib.ExitStack() as stack:
        for _ in range(40):
            with contextlib.suppress(OSError):
                stack.enter_context(connected(path)).shutdown(socket.SHUT_WR)
        time.sleep(0.5)
    return "40 half-open connections"


def byte_by_byte(path: Path) -> str:
    with connected(path) as one, contextlib.suppress(OSError):
        for byte in b'{"jsonrpc":"2.0","id":1,"method":"why"}'[:25]:
            one.send(bytes([byte]))
            time.sleep(0.02)
    return "a byte at a time"


def without_an_end(path: Path) -> str:
    sent = 0
    with connected(path) as one, contextlib.suppress(OSError):
        for _ in range(1600):
            sent += one.send(b"x" * 65536)
    assert sent < 10_000_000, "nobody reads 100 MB"
    return f"a line without an end: {sent // 1024} KiB taken"


def refused(text: bytes) -> Callable[[Path], str]:
    def speak(path: Path) -> str:
        with connected(path) as one:
            with contextlib.suppress(OSError):
                one.sendall(text + b"\n")
            told = answer(one)
            assert "result" not in told
            return told["error"]["message"][:60] if told else "ended"

    return speak


def twice(path: Path) -> str:
    """Duplicate keys: what counts must not depend on the reader."""
    return refused(b'{"jsonrpc":"2.0","id":1,"method":"why","method":"estop"}')(path)


ABUSES: dict[str, Callable[[Path], str]] = {
    "ten thousand a second": connect_and_go,
    "half open": half_open,
    "one byte now and then": byte_by_byte,
    "a line of 100 MB": without_an_end,
    "no UTF-8": refused(b'{"jsonrpc":"2.0","id":1,"method":"\xff\xfe"}'),
    "no JSON": refused(b"\x00\x01{]"),
    "nested 10^5 deep": refused(b"[" * 30_000 + b"]" * 30_000),
    "objects 10^4 deep": refused(b'{"a":' * 10_000 + b"1" + b"}" * 10_000),
    "a number of 10^4 digits": refused(
        b'{"jsonrpc":"2.0","id":1,"method":"events","params":{"limit":' + b"9" * 10_000 + b"}}"
    ),
    "duplicate keys": twice,
}


class Abused(NamedTuple):
    """One turn of all abuses; `stalls` is what a bystander missed of the ticks meanwhile."""

    missed: int
    done: int
    stalls: int
    grown_kb: int
    throttles: set[int]
    mode: str

    @property
    def good(self) -> bool:
        # The abusers run in this very process and on its processor.
        ticks = self.missed <= max(2, self.done // 20) + 2 * self.stalls
        return ticks and self.throttles == {77} and self.mode == "active"

    def __str__(self) -> str:
        return f"{self.missed} of {self.done} ticks skipped, memory +{self.grown_kb} kB"


@pytest.mark.clock
def test_f68_an_abused_api_is_bounded_and_no_tick_is_late_by_it(tmp_path, seen: Seen):
    with bystander(tmp_path) as other, driven(tmp_path) as whole, moving(whole) as driver:
        schedule = whole.loop.schedule
        told = {what: abuse(whole.socket_path) for what, abuse in ABUSES.items()}  # warms up

        def abused() -> Abused:
            driver.until_driving()
            before_kb = resident_kb()
            skipped, ticks = schedule.skipped, schedule.ticks
            other.begin()
            whole.throttles()
            for abuse in ABUSES.values():
                abuse(whole.socket_path)
            missed, done = schedule.skipped - skipped, schedule.ticks - ticks
            grown_kb = resident_kb() - before_kb
            mode = driver.result("why")["mode"]
            return Abused(missed, done, other.missed, grown_kb, whole.throttles(), mode)

        found = once_more(abused, lambda one: one.good)
        whole.until(
            lambda: driver.result("health")["api"]["clients"] <= 3, "the abusers to be forgotten"
        )
        health = driver.result("health")
    assert all(one.grown_kb < 8192 for one in found)
    closed = sum(health["api"]["closed"].values())
    seen(
        f"{len(told)} abuses while driving: {', then '.join(map(str, found))},"
        f" {health['api']['accepted']} connections, {closed} ended by the gateway;"
        f" {told['duplicate keys']}; {told['nested 10^5 deep']}"
    )


ASKER = """
import json, os, socket, sys
os.setgroups([]); os.setgid(65534); os.setuid(65534)
with socket.socket(socket.AF_UNIX) as one:
    one.connect(sys.argv[1])
    reader = one.makefile()
    for line in sys.stdin:
        one.sendall(line.encode())
        print(reader.readline(), end="")
"""


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """Every user reaches it. tmp_path is closed to them by each pytest that starts meanwhile."""
    with tempfile.TemporaryDirectory() as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.mark.clock
@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
def test_f69_a_stranger_may_read_and_stop_and_nothing_else(open_folder, seen: Seen):
    methods = ("why", "arm", "reset", "demand.set", "config.reload", "disarm")
    with driven(open_folder) as whole, moving(whole) as driver:
        whole.socket_path.chmod(0o666)

        def mode_after_a_stranger() -> str:
            driver.until_driving()
            answers = said_by_a_stranger(whole.socket_path, methods)
            mode = whole.mode
            granted = {method for method, one in answers.items() if "result" in one}
            assert granted == {"why", "disarm"}, answers
            return mode

        modes = once_more(mode_after_a_stranger, lambda mode: mode == "standby")
        events = driver.result("events", limit=200)["events"]
    refusals = [event["fields"] for event in events if event["name"] == "api_refused"]
    assert {one["method"] for one in refusals} == set(methods) - {"why", "disarm"}
    assert {one["uid"] for one in refusals} == {65534}
    # Whoever reaches the socket may stop the vehicle.
    seen(
        f"uid 65534: granted disarm, why; {len(refusals)} refusals reported;"
        f" {', then '.join(modes)}"
    )


def said_by_a_stranger(path: Path, methods: tuple[str, ...]) -> dict[str, dict]:
    """What each method answers to another user."""
    lines = []
    for number, method in enumerate(methods):
        request = {"jsonrpc": "2.0", "id": number, "method": method}
        if method == "demand.set":
            request["params"] = {"source": "me", "sequence": 1, "values": {"throttle_pct": 90}}
        lines.append(json.dumps(request))
    done = subprocess.run(
        [sys.executable, "-c", ASKER, str(path)],
        input="\n".join(lines) + "\n",
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=PATIENCE_S,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    return dict(zip(methods, answers, strict=True))


class ManualDriver:
    """A driver who arms, and then does as the test says; `next()` is its next sequence number."""

    def __init__(self, whole: Driven, client: LineClient) -> None:
        self._whole, self._client = whole, client
        self._sequence = 0

    def next(self) -> int:
        self._sequence += 1
        return self._sequence

    def arm(self) -> None:
        """Until it is active: a machine that stood still refuses for a while."""
        wait_until(self._is_armed, "the arming", PATIENCE_S)

    def _is_armed(self) -> bool:
        self._client.demand(self.next(), 0)
        self._client.request("reset", level="service")
        return self._whole.mode == "active" or "result" in self._client.request("arm")

    def drive(self) -> None:
        """Until there is throttle on the bus; the demand is one of a second."""
        self.arm()
        self._whole.throttles()
        wait_until(self._drives, "throttle on the bus", PATIENCE_S)

    def _drives(self) -> bool:
        if self._whole.mode != "active":
            self.arm()
        self._client.demand(self.next(), 30)
        return max(self._whole.throttles(), default=0) > 0


@pytest.mark.clock
def test_f70_a_driver_who_falls_silent_has_no_throttle_after_its_time_to_live(tmp_path, seen: Seen):
    with driven(tmp_path) as whole:
        whole.until_ready()
        with LineClient(whole.socket_path) as driver:
            manual = ManualDriver(whole, driver)
            manual.drive()
            driver.demand(manual.next(), 30, ttl_ms=TTL_MS)
            asked_ns = time.time_ns()
            silent = let_go(whole, asked_ns)
            assert whole.mode in ("standby", "fault")
            manual.drive()
            assert whole.mode == "active", "a new arm drives again"

        def gone_ms() -> float:
            with LineClient(whole.socket_path) as driver:
                ManualDriver(whole, driver).drive()
            return let_go(whole, time.time_ns()).last_ms

        gone = once_more(gone_ms, lambda found_ms: found_ms <= PERIOD_MS + LEEWAY_MS)
    assert silent.last_ms <= TTL_MS + PERIOD_MS
    seen(
        f"silent: throttle 0 after {silent.zero_ms:.0f} ms; gone: the last throttle after"
        f" {max(0.0, gone[-1]):.0f} ms, not only after its time to live of 1000 ms",
        silent.zero_ms,
    )


@pytest.mark.clock
def test_f71_a_second_driver_is_refused_while_the_first_is_fresh(tmp_path, seen: Seen):
    refusals = []
    with driven(tmp_path) as whole, moving(whole) as driver, LineClient(whole.socket_path) as other:
        numbers = itertools.count(10_000)

        def throttles() -> set[int]:
            driver.until_driving()
            whole.throttles()
            for _ in range(20):
                for source in ("joystick", "driver"):
                    told = other.request(
                        "demand.set",
                        source=source,
                        sequence=next(numbers),
                        values={"throttle_pct": 90, "power_mode": "turbo"},
                    )
                    refusals.append(told["error"]["data"]["refusal"])
                time.sleep(0.02)
            return whole.throttles()

        found = once_more(throttles, lambda one: one == {77})
    assert all(max(one) <= 77 for one in found)
    assert set(refusals) == {"other_owner"}
    seen(
        f"{len(refusals)} demands of a second program, in its own name and in the first's, refused"
    )


@pytest.mark.clock
def test_f72_an_old_command_is_refused_and_renews_nothing(tmp_path, seen: Seen):
    with driven(tmp_path) as whole:
        whole.until_ready()
        with LineClient(whole.socket_path) as driver:
            manual = ManualDriver(whole, driver)
            manual.drive()
            last = manual.next()
            driver.demand(last, 30, ttl_ms=TTL_MS)
            asked_ns = time.time_ns()
            over = threading.Event()
            words = []

            def play_again() -> None:
                while not over.wait(0.02):
                    words.append(driver.demand(last, 30, ttl_ms=1000)["error"]["data"]["refusal"])

            thread = threading.Thread(target=play_again)
            thread.start()
            try:
                found = let_go(whole, asked_ns)
            finally:
                over.set()
                thread.join()
            values = {"throttle_pct": 30.0, "power_mode": "normal"}
            now_ns = time.monotonic_ns()
            for made_ns, word in (
                (now_ns - 300 * MS, "expired"),
                (now_ns + 600 * 10**9, "from_the_future"),
            ):
                told = driver.request(
                    "demand.set", source="driver", sequence=manual.next(), ttl_ms=TTL_MS,
                    values=values, made_ns=made_ns,
                )  # fmt: skip
                words.append(told["error"]["data"]["refusal"])
                assert words[-1] == word
    assert set(words) == {"old_sequence", "expired", "from_the_future"}
    assert found.last_ms <= TTL_MS + PERIOD_MS
    seen(
        f"{len(words)} old commands refused; throttle 0 after {found.zero_ms:.0f} ms", found.zero_ms
    )
