"""What a gateway hands over is bounded and checked before anything of it is kept."""

import json
import os
import socket
import subprocess

import pytest

from vcu_gateway.recorder.connection import (
    MOST_LINES_BYTES,
    GatewayConnection,
    check_lines,
    checked_hello,
)
from vcu_gateway.recorder.receiver import Backlog, Received
from vcu_gateway.recorder.senders import RunOwners, Sender
from vcu_gateway.recording.datagram import DatagramError, TickHeader, packed_tick, tick_parts

HELLO = {
    "format": 1,
    "run": "1f3a9c2e" * 4,
    "channel": "can0",
    "clock": {"monotonic_ns": 5, "wall_ns": 1_763_920_000_000_000_000},
    "config": "bus: {channel: can0}\n",
    "dbc": 'VERSION ""\n',
    "settings": {"battery": {"warm_degc": 45.5, "on": True, "none": None}},
}
NESTED = {"a": {"a": {"a": {"a": {"a": {"a": {"a": {"a": {"a": 1}}}}}}}}}


def test_an_ordinary_hello_is_taken():
    assert checked_hello(HELLO) == HELLO


@pytest.mark.parametrize(
    "changed",
    [
        {"run": ""},
        {"run": "../../etc"},
        {"run": "a" * 65},
        {"channel": "can 0"},
        {"channel": "c" * 1_000_000},
        {"clock": {"monotonic_ns": 5, "wall_ns": 10**20}},
        {"clock": {"monotonic_ns": -1, "wall_ns": 5}},
        {"clock": {"monotonic_ns": True, "wall_ns": 5}},
        {"config": "\ud800"},
        {"dbc": "x" * 300_000},
        {"boot": "\udfff"},
        {"settings": NESTED},
        {"settings": {"a": float("inf")}},
        {"settings": {"a": 10**30}},
        {"settings": [0] * 6_000},
        {"versions": "v" * 2_000},
    ],
    ids=str,
)
def test_a_hello_outside_the_bounds_is_refused(changed):
    with pytest.raises(DatagramError, match="HELLO") as refused:
        checked_hello(HELLO | changed)
    assert refused.value.kind == "hello"


@pytest.mark.parametrize(
    "lines",
    [
        b"",
        b'{"f":3,"tick":5,"frames":[["PCU1","0008A7D0","00"]],"ok":[true],"mode":"active"}\n',
        b'{"f":0,"event":["x","info",{}],"now":5}\n{"f":1,"tick":5,"events":[["a","b",{}]]}\n',
        b'{"checkpoint":{"state":{"x":[1.5,null]},"ticks":3,"frames":4},"f":0}\n{"f":0,"tick":1}\n',
        b'{"f":0,"why":"\\ud800","now":5}\n',
    ],
)
def test_core_lines_of_a_gateway_are_taken(lines):
    check_lines(lines)


@pytest.mark.parametrize(
    "lines",
    [
        b'{"f":1,"tick":5,"events":5}\n',
        b'{"f":1,"tick":5,"events":[["fault_latched","critical",7]]}\n',
        b'{"f":1,"tick":5,"events":[[{},"critical",{}]]}\n',
        b'{"checkpoint":{"ticks":Infinity,"frames":0},"f":0}\n',
        b'{"checkpoint":{"ticks":1e400,"frames":0},"f":0}\n',
        b'{"checkpoint":{"ticks":1.5,"frames":0},"f":0}\n',
        b'{"checkpoint":[],"f":0}\n',
        b'{"f":0,"tick":1}\n{"checkpoint":{"ticks":1,"frames":0},"f":0}\n',
        b'{"f":-1}\n',
        b'{"f":true}\n',
        b'{"f":99999999999999999999}\n',
        b'{"f":0,"tick":"now"}\n',
        b"{}\n",
        b"[1]\n",
        b"\n",
        b'{"f":0}\r{"f":0}\n',
        b"\xff\xfe\n",
        b'{"f":0,"end":{"frames":0,"why":"the connection ended"}}\n',
        b'{"f":0,"gap":{"frames":1,"ticks":1}}\n',
        b'{"f":' + b"[" * 50_000 + b"\n",
        b'{"f":' + b"1" * 5_000 + b"}\n",
        b'{"f":0}\n' * 10_001,
        json.dumps({"f": 0, "why": "x" * MOST_LINES_BYTES}).encode() + b"\n",
    ],
    ids=lambda lines: lines[:60].decode(errors="replace"),
)
def test_core_lines_that_are_none_of_a_gateway_are_refused(lines):
    with pytest.raises(DatagramError) as refused:
        check_lines(lines)
    assert refused.value.kind == "core_lines"


def test_a_run_is_that_of_the_process_that_named_it_first_as_long_as_that_one_lives():
    owners, mine = RunOwners(), Sender(os.getpid(), 0, 0)
    parent = Sender(os.getppid(), 0, 0)
    assert owners.other("a", mine) is None
    assert owners.other("a", mine) is None
    assert owners.other("a", parent) == mine
    assert owners.other("b", parent) is None
    gone = subprocess.Popen(["true"])
    gone.wait()
    assert owners.other("c", Sender(gone.pid, 0, 0)) is None
    assert owners.other("c", mine) is None


def test_who_names_many_runs_does_not_make_anothers_forgotten():
    owners, mine = RunOwners(), Sender(os.getpid(), 0, 0)
    parent = Sender(os.getppid(), 0, 0)
    assert owners.other("mine", mine) is None
    for number in range(2000):
        assert owners.other(f"theirs {number}", parent) is None
    assert owners.other("mine", parent) == mine


def test_what_has_just_come_stays_however_little_memory_there_is():
    one, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with one, other:
        backlog, connection = Backlog(max_bytes=1), GatewayConnection(one, Sender(1, 0, 0))
        tick = tick_parts(packed_tick(TickHeader(1, 0, 0, 0), [], '{"f":0}\n'))
        backlog.put(Received(connection, tick))
        assert backlog.take() == Received(connection, tick)
        assert not connection.begin_again
