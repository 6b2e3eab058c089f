"""Any bytes at all: the parser answers or refuses, the server lives, and nothing grows.

HYPOTHESIS_PROFILE=nightly tries 1,000,000 lines and 20,000 connections.
"""

import contextlib
import gc
import json
import os
import random
import resource
import socket
import time
import tracemalloc
from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.server.conftest import Client, eventually
from vcu_gateway.api.methods import METHODS, Params
from vcu_gateway.server import jsonrpc
from vcu_gateway.server.service import SessionLimits
from vcu_gateway.server.session import MAX_LINE_BYTES

NIGHTLY = settings().max_examples > 1000
LINES = 1_000_000 if NIGHTLY else 20_000
CONNECTIONS = 20_000 if NIGHTLY else 300
SEED = 20_260_801
MAX_GROWTH_KIB = 16_384
MAX_KEPT_BYTES = 65_536
QUICK = SessionLimits(rate_per_s=1_000_000, burst=1_000_000)

DEMAND = {"source": "pedal", "sequence": 41, "ttl_ms": 200, "made_ns": 123456789}
VALUES = {"throttle_pct": 12.5, "brake_pct": 0, "power_mode": "eco", "motor_reverse": False}
PARAMS = {
    "state.get": {"messages": ["BMS_Status", "IMU"]},
    "state.subscribe": {"messages": None, "rate_hz": 10.5},
    "state.unsubscribe": {"subscription": 3},
    "demand.set": {**DEMAND, "values": VALUES},
    "demand.release": {"source": "pedal"},
    "reset": {"level": "service"},
    "events": {"limit": 20},
}
VALID = [
    json.dumps({"jsonrpc": "2.0", "id": number, "method": name, "params": PARAMS.get(name, {})})
    for number, name in enumerate(METHODS)
]
BOTH = {**DEMAND, "controllers": {"PCU1": VALUES, "PCU2": {}}}
VALID += [
    json.dumps({"jsonrpc": "2.0", "method": "demand.set", "params": BOTH}),
    json.dumps({"jsonrpc": "2.0", "id": "Grüße 😀", "method": "arm"}),
    json.dumps({"jsonrpc": "2.0", "id": "Grüße 😀", "method": "estop"}, ensure_ascii=False),
]
SEEDS = [line.encode() for line in VALID]
TOKENS = [
    *(b'{ } [ ] , : " \\ \\u \\ud800 \\udfff \\u0000'.split()),
    *(b"null true false NaN Infinity -Infinity".split()),
    *(b"-0 0.0 1e999 -1e-999 1e5 01 +1 .5 0x10 9223372036854775808 18446744073709551616".split()),
    *(b'"jsonrpc" "id" "method" "params" "values" "2.0" {"a":1} [[]] {"":{}} "id":1, []'.split()),
    b"9" * 5000, b"[" * 20, b'{"a":' * 20, b"]" * 20, b"1," * 600, b"\xff", b"\xed\xa0\x80",
    b"\xef\xbb\xbf", b"\x00", b"\r", b" " * 100, b"a" * 70, "😀".encode(), b"\xc0\x80",
]  # fmt: skip
NAMES = ["id", "method", "mehtod", "param", "source", "PCU1", "PCU3", "throttle_pct", "", "é"]
OTHER_VALUES = [None, True, 0, -1, 1.5, 2**63, 2**64, 1e308, "", "arm", "arn", "eco", [], {}, [1]]


def changed(line: bytes, rng: random.Random) -> bytes:
    """The line as JSON with one member gone, renamed or replaced, at any depth."""
    message = here = json.loads(line)
    while inner := [value for value in here.values() if isinstance(value, dict) and value]:
        if rng.random() < 0.3:
            break
        here = rng.choice(inner)
    name = rng.choice(list(here))
    value = here.pop(name)
    kind = rng.randrange(3)
    if kind == 0:
        here[rng.choice(NAMES)] = value
    elif kind == 1:
        here[name] = rng.choice(OTHER_VALUES)
    return json.dumps(message).encode()


def flipped(data: bytes, at: int, rng: random.Random) -> bytes:
    return data[:at] + bytes(byte ^ 1 << rng.randrange(8) for byte in data[at : at + 1])


def many(rng: random.Random) -> bytes:
    token = rng.choice(TOKENS)
    return token * rng.randrange(1, MAX_LINE_BYTES // len(token))


CHANGES = [
    lambda data, at, to, rng: flipped(data, at, rng) + data[at + 1 :],
    lambda data, at, to, rng: data[:at] + rng.randbytes(rng.randrange(1, 4)) + data[at:],
    lambda data, at, to, rng: data[:at] + rng.choice(TOKENS) + data[at:],
    lambda data, at, to, rng: data[:at] + rng.choice(TOKENS) + data[to:],
    lambda data, at, to, rng: data[:at] + data[to:],
    lambda data, at, to, rng: data[:to] + data[at:],
    lambda data, at, to, rng: data[:at] + rng.choice(SEEDS)[at:to] + data[to:],
]


def mutated(line: bytes, rng: random.Random) -> bytes:
    """The line with a few changes, of the kinds that programs and attackers make."""
    data = changed(line, rng) if rng.random() < 0.4 else line
    for _ in range(rng.choice((0, 1, 1, 1, 2, 4))):
        at, to = sorted((rng.randrange(len(data) + 1), rng.randrange(len(data) + 1)))
        data = rng.choice(CHANGES)(data, at, to, rng)
    if rng.random() < 0.001:
        data = data[:10] + many(rng) + data[10:]
    return data[:MAX_LINE_BYTES]


def judge(line: bytes) -> str:
    """What became of the line; that it is in order."""
    answer = jsonrpc.parse(line)
    if isinstance(answer, jsonrpc.Request):
        assert answer.method in METHODS
        assert isinstance(answer.params, Params)
        assert (
            answer.id is None or json.loads(jsonrpc.result_line(answer.id, {}))["id"] == answer.id
        )
        return "request"
    out = jsonrpc.error_line(answer.id, answer.error)
    assert len(answer.error.sentence) <= jsonrpc.MAX_SENTENCE_CHARACTERS
    assert len(out) < 2000
    assert out.count(b"\n") == 1
    return answer.error.code.name


@pytest.mark.timeout(1800)
def test_mutated_requests_are_answered_or_refused_and_nothing_grows():
    rng, seen = random.Random(SEED), Counter()
    begin_s, before_kib = time.monotonic(), 0
    for number in range(LINES):
        if number == LINES // 10:
            before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        seen[judge(mutated(rng.choice(SEEDS), rng))] += 1
    growth_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib
    rate = LINES / (time.monotonic() - begin_s)
    print(f"\n{LINES} lines, {rate:.0f} a second, grew {growth_kib} KiB: {dict(seen)}")
    assert growth_kib < MAX_GROWTH_KIB
    # The mutations reach every floor of the parser.
    for kind in ("request", "PARSE_ERROR", "INVALID_REQUEST", "METHOD_NOT_FOUND", "INVALID_PARAMS"):
        assert seen[kind] > LINES // 500, seen


def test_parsing_keeps_nothing():
    rng = random.Random(SEED)
    lines = [mutated(rng.choice(SEEDS), rng) for _ in range(3000)]
    for line in lines:  # what is kept once, such as caches
        judge(line)
    gc.collect()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for line in lines:
            judge(line)
        gc.collect()
        kept = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert kept < MAX_KEPT_BYTES


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=80),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=20), inner),
    max_leaves=20,
)
MEMBERS = st.fixed_dictionaries(
    {"jsonrpc": st.just("2.0"), "method": st.sampled_from(sorted(METHODS)) | st.text()},
    optional={
        "id": st.integers() | st.text() | JSON,
        "params": JSON
        | st.dictionaries(
            st.sampled_from(["messages", "rate_hz", "source", "sequence", "values", "limit"]), JSON
        ),
    },
)


@given(st.binary(max_size=300))
def test_any_bytes_are_answered_or_refused(line):
    judge(line)


@given(MEMBERS | JSON)
def test_any_json_is_answered_or_refused(message):
    judge(json.dumps(message).encode())
    with contextlib.suppress(UnicodeEncodeError):
        judge(json.dumps(message, ensure_ascii=False).encode())


def stream(rng: random.Random) -> bytes:
    """What one hostile connection sends."""
    parts = []
    for _ in range(rng.randrange(1, 12)):
        line = rng.choice(SEEDS)
        parts.append(mutated(line, rng) if rng.random() < 0.7 else line)
        parts.append(b"\n" if rng.random() < 0.9 else b"")
    if rng.random() < 0.03:
        parts.append(b"x" * 70_000)
    return b"".join(parts)


def talk(path: str, rng: random.Random) -> None:
    """Send in pieces, read now and then, and leave in one way or another."""
    data = stream(rng)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as sock, contextlib.suppress(OSError):
        sock.connect(path)
        sock.setblocking(False)
        while data:
            size = rng.choice((1, 7, 100, 4096, 100_000))
            data = data[sock.send(data[:size]) :]
            if rng.random() < 0.3:
                with contextlib.suppress(BlockingIOError):
                    sock.recv(4096)
        if rng.random() < 0.5:
            sock.shutdown(rng.choice((socket.SHUT_WR, socket.SHUT_RD, socket.SHUT_RDWR)))
        if rng.random() < 0.3:
            sock.settimeout(0.005)
            while sock.recv(65536):
                pass


@pytest.mark.timeout(1800)
def test_the_server_lives_through_any_connection_and_forgets_it(idle_api):
    api = idle_api.start(QUICK)
    rng, begin_s = random.Random(SEED), time.monotonic()
    client: Client = api.connect()
    assert client.ask("why")
    files = len(os.listdir("/proc/self/fd"))
    for number in range(CONNECTIONS):
        talk(os.fspath(api.path), rng)
        api.service.begun.clear()
        if number % 20 == 0:
            api.service.release()
            assert api.server.failed is None
    print(f"\n{CONNECTIONS} connections, {CONNECTIONS / (time.monotonic() - begin_s):.0f} a second")
    eventually(lambda: api.service.release() or api.counts()["clients"] == 1)
    eventually(lambda: len(api.service.calls_of("end_demands")) == api.counts()["accepted"] - 1)
    eventually(lambda: len(os.listdir("/proc/self/fd")) <= files)
    assert client.ask("why")
    assert api.server.failed is None
