"""The API abused, and its operators gone wrong, while the vehicle drives."""

import contextlib
import json
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.core.safety_world import ZERO_TORQUE
from tests.driven import Driven, driven
from tests.faults.conftest import ROOT, Seen
from tests.faults.machine import resident_kb
from tests.faults.pure.test_process import commands, moving
from tests.faults.speaking import Speaker

MS = 1_000_000
TTL_MS = 200
LEEWAY_MS = 150  # a tick, and what a busy machine may take


@contextlib.contextmanager
def connected(path: Path) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX) as one:
        one.settimeout(10)
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


def refused(text: bytes) -> str:
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


ABUSES = {
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


def test_f68_an_abused_api_is_bounded_and_no_tick_is_late_by_it(tmp_path, seen: Seen):
    with driven(tmp_path) as whole, moving(whole) as asker:
        schedule = whole.daemon.schedule
        told = {what: abuse(whole.socket_path) for what, abuse in ABUSES.items()}  # warms up
        skipped, ticks = schedule.skipped, schedule.ticks
        before_kb = resident_kb()
        commands(whole)
        for abuse in ABUSES.values():
            abuse(whole.socket_path)
        missed, done = schedule.skipped - skipped, schedule.ticks - ticks
        grown_kb = resident_kb() - before_kb
        assert asker.result("why")["mode"] == "active"
        assert {frame[1] for frame in commands(whole)} == {77}
        whole.until(
            lambda: asker.result("health")["api"]["clients"] <= 3, "the abusers to be forgotten"
        )
        health = asker.result("health")
    # The abusers run in this very process and on its processor.
    assert missed <= max(2, done // 20), f"{missed} of {done}"
    assert grown_kb < 8192
    closed = sum(health["api"]["closed"].values())
    seen(
        f"{len(told)} abuses while driving: {missed} of {done} ticks skipped, memory +{grown_kb}"
        f" kB, {health['api']['accepted']} connections, {closed} ended by the gateway;"
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


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become somebody else")
def test_f69_a_stranger_may_read_and_stop_and_nothing_else(tmp_path, seen: Seen):
    import subprocess

    for parent in (tmp_path, *tmp_path.parents[:2]):
        parent.chmod(0o755)
    config = ""
    with driven(tmp_path, config) as whole, moving(whole) as asker:
        whole.socket_path.chmod(0o666)
        methods = ("why", "arm", "reset", "demand.set", "config.reload", "disarm")
        lines = []
        for number, method in enumerate(methods):
            request = {"jsonrpc": "2.0", "id": number, "method": method}
            if method == "demand.set":
                request["params"] = {"source": "me", "sequence": 1, "values": {"throttle_pct": 90}}
            lines.append(json.dumps(request))
        done = subprocess.run(
            [sys.executable, "-c", ASKER, str(whole.socket_path)],
            input="\n".join(lines) + "\n",
            capture_output=True,
            text=True,
            cwd=ROOT,
            timeout=30,
        )
        answers = [json.loads(line) for line in done.stdout.splitlines()]
        events = asker.result("events", limit=200)["events"]
        stopped = whole.mode
    told = {
        method: one.get("error", {}).get("data", {}).get("right", "granted")
        if "error" in one
        else "granted"
        for method, one in zip(methods, answers, strict=True)
    }
    granted = {method for method, one in zip(methods, answers, strict=True) if "result" in one}
    assert granted == {"why", "disarm"}, told
    refusals = [event["fields"] for event in events if event["name"] == "api_refused"]
    assert {one["method"] for one in refusals} == set(methods) - granted
    assert {one["uid"] for one in refusals} == {65534}
    assert stopped == "standby", "whoever reaches the socket may stop the vehicle"
    seen(f"uid 65534: granted {', '.join(sorted(granted))}; {len(refusals)} refusals told")


def test_f70_a_driver_who_falls_silent_has_no_throttle_after_its_time_to_live(tmp_path, seen: Seen):
    with driven(tmp_path) as whole:
        whole.until_ready()
        with Speaker(whole.socket_path) as driver:
            driver.demand(1, 0)
            driver.result("arm")
            for sequence in range(2, 12):
                driver.demand(sequence, 30, ttl_ms=TTL_MS)
                asked_ns = time.monotonic_ns()
                time.sleep(0.05)
            silent_ms = until_zero_ms(whole, asked_ns)
            assert whole.mode == "standby"
            driver.demand(12, 0)
            assert "error" not in driver.say("arm"), "a new arm drives again"
            driver.demand(13, 30, ttl_ms=1000)
            whole.until(lambda: whole.mode == "active", "driving")
            time.sleep(0.2)
            gone_ns = time.monotonic_ns()
        gone_ms = until_zero_ms(whole, gone_ns)
        assert whole.mode == "standby"
    assert silent_ms <= TTL_MS + LEEWAY_MS
    assert gone_ms <= 50 + LEEWAY_MS, "at its end, not only after its time to live of 1000 ms"
    seen(f"silent: throttle 0 after {silent_ms:.0f} ms; gone: after {gone_ms:.0f} ms", silent_ms)


def until_zero_ms(whole: Driven, since_ns: int) -> float:
    """From then to the first zero torque after the last throttle."""
    commands(whole)
    last = {}
    end_s = time.monotonic() + 5
    while time.monotonic() < end_s:
        heard = commands(whole)
        if heard and set(heard) == {ZERO_TORQUE}:
            return (time.monotonic_ns() - since_ns) / MS
        last.update(dict.fromkeys(heard))
        time.sleep(0.002)
    raise AssertionError(f"throttle still: {last}")


def test_f71_a_second_driver_is_refused_while_the_first_is_fresh(tmp_path, seen: Seen):
    with driven(tmp_path) as whole, moving(whole), Speaker(whole.socket_path) as other:
        commands(whole)
        refusals = []
        for sequence in range(1, 20):
            for source in ("joystick", "driver"):
                told = other.say(
                    "demand.set",
                    source=source,
                    sequence=10_000 + sequence,
                    values={"throttle_pct": 90, "power_mode": "turbo"},
                )
                refusals.append(told["error"]["data"]["refusal"])
            time.sleep(0.02)
        assert {frame[1] for frame in commands(whole)} == {77}
    assert set(refusals) == {"other_owner"}
    seen(
        f"{len(refusals)} demands of a second program, in its own name and in the first's, refused"
    )


def test_f72_an_old_command_is_refused_and_renews_nothing(tmp_path, seen: Seen):
    with driven(tmp_path) as whole:
        whole.until_ready()
        with Speaker(whole.socket_path) as driver:
            driver.demand(1, 0)
            driver.result("arm")
            driver.demand(2, 30, ttl_ms=TTL_MS)
            asked_ns = time.monotonic_ns()
            over = threading.Event()
            words = []

            def play_again() -> None:
                while not over.wait(0.02):
                    words.append(driver.demand(2, 30, ttl_ms=1000)["error"]["data"]["refusal"])

            thread = threading.Thread(target=play_again)
            thread.start()
            found_ms = until_zero_ms(whole, asked_ns)
            over.set()
            thread.join()
            values = {"throttle_pct": 30.0, "power_mode": "normal"}
            now_ns = time.monotonic_ns()
            for made_ns, word in (
                (now_ns - 300 * MS, "expired"),
                (now_ns + 10**9, "from_the_future"),
            ):
                told = driver.say(
                    "demand.set", source="driver", sequence=3, ttl_ms=TTL_MS, values=values,
                    made_ns=made_ns,
                )  # fmt: skip
                words.append(told["error"]["data"]["refusal"])
                assert words[-1] == word
    assert set(words) == {"old_sequence", "expired", "from_the_future"}
    assert found_ms <= TTL_MS + LEEWAY_MS
    seen(f"{len(words)} old commands refused; throttle 0 after {found_ms:.0f} ms", found_ms)
