"""Whatever others hand over, the honest drive is whole, and the recorder lives in its memory."""

import contextlib
import json
import os
import random
import re
import socket
import struct
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.recorder.gateway import account, drives, incidents
from vcu_gateway.recorder.senders import Refusals, trusted_users
from vcu_gateway.recording import datagram, layout
from vcu_gateway.recording.datagram import TickHeader

UNIT = Path(__file__).parents[2] / "systemd/vcu-gateway-recorder.service"
MEMORY_MAX_KB = int(re.search(r"^MemoryMax=(\d+)M$", UNIT.read_text(), re.MULTILINE)[1]) << 10

IMPOSTOR = """
import socket, sys, time
from vcu_gateway.recording import datagram
sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
sock.connect(sys.argv[1])
for part in datagram.packed_hello(__import__("json").loads(sys.argv[2])):
    sock.send(part)
time.sleep(0.1)
print(len(sock.recv(1)))
"""


def connection(path):
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    sock.settimeout(10)
    sock.connect(str(path))
    return sock


def is_closed(sock):
    """Wait for the recorder's end of it."""
    try:
        return sock.recv(1) == b""
    except ConnectionResetError:
        return True


def send(sock, *parts):
    with contextlib.suppress(BrokenPipeError, ConnectionResetError):
        for part in parts:
            sock.send(part)


def hello(run="f" * 32, **more):
    values = {
        "format": 1,
        "run": run,
        "channel": "can9",
        "clock": {"monotonic_ns": 1, "wall_ns": 1_763_920_000_000_000_000},
        "config": "",
        "dbc": "",
        "settings": {},
    }
    return list(datagram.packed_hello(values | more))


def tick(lines, number=1):
    return datagram.packed_tick(TickHeader(number, 0, 0, 0), [], lines)


CHECKPOINT = '{"checkpoint":{"ticks":0,"frames":0},"f":0}\n'
HOSTILE = {
    "events that are a number": [*hello(), tick(CHECKPOINT + '{"f":0,"tick":1,"events":5}\n')],
    "half a surrogate": hello(config="\ud800"),
    "a clock of 67 bits": hello(clock={"monotonic_ns": 1, "wall_ns": 10**20}),
    "endless ticks": [*hello(), tick('{"checkpoint":{"ticks":Infinity,"frames":0},"f":0}\n')],
    "a channel of 1 MB": hello(channel="c" * 1_000_000),
    "an empty datagram's kind": [b"\x01"],
}


@pytest.mark.parametrize("what", HOSTILE)
def test_one_hostile_connection_ends_alone_and_is_counted(what, recorder, gateway, tmp_path):
    process = recorder()
    vehicle = gateway()
    vehicle.drive(0.2)
    with connection(process.socket) as sock:
        send(sock, *HOSTILE[what])
        assert is_closed(sock)
    vehicle.drive(0.2)
    vehicle.close()
    counted = process.wait_for(lambda status: sum(status["refused"].values()) > 0)
    assert sum(counted["refused"].values()) == 1
    assert process.stop() == 0
    assert process.errors.count("is closed:") == 1
    honest = [one for one in drives(tmp_path) if vehicle.run.startswith(one.name[-8:])]
    assert account(honest[0]) == (vehicle.frames, 0)


def test_an_impostor_with_the_run_of_a_connected_gateway_is_refused(recorder, gateway, tmp_path):
    process = recorder()
    vehicle = gateway()
    vehicle.drive(0.3)
    command = [sys.executable, "-c", IMPOSTOR, process.socket, json.dumps(vehicle.hello())]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.strip() == "0" or "ConnectionReset" in done.stderr
    vehicle.drive(0.3)
    process.wait_for(lambda status: status["refused"] == {"run": 1})
    assert process.stop() == 0
    (drive,) = drives(tmp_path)
    assert account(drive) == (vehicle.frames, 0)


def test_an_unfinished_hello_is_given_five_seconds(recorder, tmp_path):
    process = recorder()
    process.wait_for(lambda status: True)
    begin_s = time.monotonic()
    with connection(process.socket) as sock:
        send(sock, bytes((datagram.HELLO, datagram.FORMAT, 0)) + b"{")
        assert is_closed(sock)
    assert time.monotonic() - begin_s >= 5
    process.wait_for(lambda status: status["refused"] == {"hello_late": 1})


def test_an_incident_that_cannot_be_made_leaves_the_next_one_and_the_disk(
    recorder, gateway, tmp_path
):
    process = recorder()
    vehicle = gateway()
    vehicle.drive(0.2)
    # A name that is too long once, and a folder that is a file: neither is the disk's fault.
    vehicle.latch("x" * 300)
    process.wait_for(lambda status: status["incidents"] == 1)
    assert process.status["disk"] == "ok"
    (first,) = incidents(tmp_path)
    assert first.name.endswith("Z-" + "x" * 40)
    folder = tmp_path / "recordings" / layout.INCIDENTS
    folder.rename(folder.with_name("aside"))
    folder.write_text("")
    second = gateway(seed=2, channel="can7")
    second.drive(0.2)
    second.latch()
    process.wait_for(lambda status: status["refused"].get("incident"))
    folder.unlink()
    folder.with_name("aside").rename(folder)
    third = gateway(seed=3, channel="can8")
    third.drive(0.2)
    third.tick(more='{"f":0,"estop":true,"granted":true}\n')
    process.wait_for(lambda status: status["incidents"] == 2)
    assert process.status["disk"] == "ok"
    assert process.status["totals"]["bytes"] > 0
    assert "failing" not in process.errors
    assert incidents(tmp_path)[-1].name.endswith("emergency_stop")


def any_header(chance):
    return TickHeader(*(chance.randrange(1 << 64) for _ in range(4)))


def many_frames(chance):
    stamps = [chance.randrange(-1 << 63, 1 << 63) for _ in range(chance.randrange(200))]
    frames = [datagram.packed_frame(one, chance.randrange(1 << 32), True, b"") for one in stamps]
    return datagram.packed_tick(TickHeader(1, len(frames), 0, 0), frames, CHECKPOINT)


def any_events(chance):
    events = chance.choice(["5", "[[1,2,3]]", '{"a":1}', '[["fault_latched","x",{"reason":[]}]]'])
    return tick(CHECKPOINT + f'{{"f":0,"tick":1,"mode":"fault","events":{events}}}\n')


KINDS = (
    lambda chance: chance.randbytes(chance.randrange(1, 3_000)),
    lambda chance: bytes((2, 1, 0)) + chance.randbytes(chance.randrange(80)),
    lambda chance: bytes((1, 1, 0)) + b"[" * chance.randrange(64_000),
    lambda chance: datagram.packed_tick(any_header(chance), [], CHECKPOINT),
    lambda chance: tick(CHECKPOINT + '{"f":0,"why":"' + "x" * chance.randrange(90_000) + '"}\n'),
    lambda chance: tick(CHECKPOINT + '{"f":0,"x":' + "[" * 900 + "]" * 900 + "}\n"),
    many_frames,
    any_events,
    lambda chance: struct.pack("<BBBQQQQI", 2, 1, 0, 1, 5, 0, 0, 1 << 31) + chance.randbytes(99),
)


def attack(path, connections, datagrams, seed):
    """So many connections after each other, each with its share of the datagrams."""
    chance = random.Random(seed)
    sent, open_ones = 0, []
    for number in range(connections):
        try:
            sock = connection(path)
        except OSError:
            continue
        open_ones.append(sock)
        begin = chance.choice([hello(run=f"{number:032x}"), hello(run=f"{number:032x}")[:-1], []])
        send(sock, *begin)
        for _ in range(datagrams // connections):
            sent += 1
            try:
                sock.send(chance.choice(KINDS)(chance))
            except (BrokenPipeError, ConnectionResetError):  # closed: go on with another one
                sock.close()
                sock = connection(path)
                open_ones.append(sock)
                send(sock, *hello(run=f"{number:032x}"))
            except OSError:
                pass
        while len(open_ones) > 12:
            open_ones.pop(0).close()
    for sock in open_ones:
        sock.close()
    return sent


def peak_kb(pid):
    return int(re.search(r"VmHWM:\s*(\d+)", Path(f"/proc/{pid}/status").read_text())[1])


@pytest.mark.parametrize(
    ("connections", "datagrams"),
    [(20, 300), pytest.param(200, 10_000, marks=pytest.mark.ci)],
)
def test_an_honest_drive_is_whole_beside_hostile_connections(
    connections, datagrams, recorder, gateway, tmp_path
):
    process = recorder()
    vehicle = gateway()
    done = threading.Event()
    sent = []

    def hostile():
        try:
            sent.append(attack(process.socket, connections, datagrams, seed=24))
        finally:
            done.set()

    thread = threading.Thread(target=hostile)
    thread.start()
    while not done.is_set():
        vehicle.drive(0.5)
    thread.join()
    vehicle.drive(0.5)
    vehicle.close()
    peak = peak_kb(process.process.pid)
    refused = process.wait_for(lambda status: sum(status["refused"].values()) > 0)["refused"]
    process.wait_for(lambda status: status["memory"]["bytes"] == 0, timeout_s=60)
    assert process.stop() == 0, process.errors
    assert sent == [datagrams]
    assert peak < MEMORY_MAX_KB
    honest = [one for one in drives(tmp_path) if vehicle.run.startswith(one.name[-8:])]
    assert account(honest[0]) == (vehicle.frames, 0)
    assert vehicle.datagrams_lost == 0
    assert sum(refused.values()) > connections // 2
    print(f"peak {peak} kB of {MEMORY_MAX_KB}, refused {refused}")


def test_only_root_the_own_user_and_the_gateways_are_trusted():
    assert trusted_users(None) >= {0, os.geteuid()}
    with pytest.raises(Exception, match="no user nobody-of-this-name"):
        trusted_users("nobody-of-this-name")


def test_a_kind_of_refusal_is_one_line_in_ten_seconds_and_counted():
    said = []
    refusals = Refusals(said.append)
    for _ in range(5):
        refusals.note("sender", "turned away")
    refusals.note("run", "its run is another's")
    assert said == ["turned away", "its run is another's"]
    assert refusals.counts == {"sender": 5, "run": 1}
