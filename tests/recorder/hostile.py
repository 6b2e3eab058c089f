"""A process that sends the recorder what no gateway does: seeded, from connections of its own.

    python -m tests.recorder.hostile SOCKET RUN SEED DATAGRAMS CONNECTIONS

RUN is that of an honest gateway, which some of the connections pretend to be.
"""

import contextlib
import json
import random
import socket
import struct
import sys
import time

from tests.recorder.gateway import Gateway
from vcu_gateway.recording import datagram
from vcu_gateway.recording.datagram import TickHeader

HELD = 15
LINES = [
    '{"f":0,"events":5}\n',
    '{"f":0,"events":[["fault_latched","x",{"reason":"' + "a" * 300 + '"}]]}\n',
    '{"f":0,"end":{"frames":0,"ticks":0,"closes":true,"why":"forged"}}\n',
    '{"checkpoint":{"ticks":Infinity,"frames":0},"f":0}\n',
    '{"checkpoint":{"ticks":' + "9" * 5000 + '},"f":0}\n',
    '{"f":0,"why":"\\ud800"}\n',
    '{"f":0,"why":' + "[" * 50_000 + "]" * 50_000 + "}\n",
    '{"f":0,"why":[' + "[]," * 50_000 + "[]]}\n",
    '{"f":0,"estop":true}\n',
    "no JSON\n",
    "\n",
    "no line end",
]
HELLOS = [
    {"config": "\ud800"},
    {"dbc": "\U0001f600" + "x" * 900_000},
    {"clock": {"monotonic_ns": 0, "wall_ns": 10**20}},
    {"channel": "x" * 900_000},
    {"run": "../../../etc/passwd"},
    {"run": 5},
    {"settings": [[]] * 90_000},
    {"format": 2},
]


class HostileSender:
    """One connection that means no good; `datagrams` counts what was sent."""

    def __init__(self, path, run, chance):
        self.datagrams = 0
        self._run = run
        self._chance = chance
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.settimeout(2)
        self._socket.connect(path)
        self._gateway = Gateway(path, channel="evil0", seed=chance.random())
        if chance.random() < 0.2:
            self._gateway.run = run

    def close(self):
        self._socket.close()

    def act(self, most):
        """Be odd in one of several ways, until the recorder ends it or for so many datagrams."""
        acts = (self.noise, self.odd_hello, self.unfinished_hello, self.ticks, self.odd_tick)
        with contextlib.suppress(OSError):
            self._chance.choice(acts)(most)

    def send(self, data):
        self._socket.send(data)
        self.datagrams += 1

    def say_hello(self, **changed):
        for part in datagram.packed_hello(self._gateway.hello() | changed):
            self.send(part)

    def noise(self, most):
        for _ in range(most):
            kind = self._chance.choice((b"", b"\1\1\0", b"\1\1\1", b"\2\1\0", b"\3"))
            self.send(kind + self._chance.randbytes(self._chance.randrange(1, 2000)))

    def odd_hello(self, most):
        del most
        self.say_hello(**self._chance.choice(HELLOS))

    def unfinished_hello(self, most):
        for _ in range(min(most, 15)):
            self.send(b"\1\1\0" + b"x" * datagram.PART_BYTES)

    def odd_tick(self, most):
        del most
        self.say_hello()
        first = self._gateway._checkpoint() if self._chance.random() < 0.5 else ""
        count = self._chance.choice((0, 1, 1 << 63, (1 << 64) - 1))
        header = TickHeader(
            self._chance.choice((1, 1 << 63)), count, 0, self._chance.choice((0, 5))
        )
        body = datagram.packed_tick(header, [], "")
        if self._chance.random() < 0.3:
            body = body[:-4] + struct.pack("<I", self._chance.randrange(1 << 32))
        self.send(body + (first + self._chance.choice(LINES)).encode())
        self.send(b"".join(datagram.packed_hello(self._gateway.hello())))

    def ticks(self, most):
        """Like a gateway's, as quick as they go, each a segment of its own."""
        self.say_hello()
        gateway = self._gateway
        gateway.sock = self._socket
        for _ in range(most):
            gateway.begin_segment()
            if not gateway.tick(frames=self._chance.randrange(50)) and gateway.sock is None:
                return
            self.datagrams += 1
            if self._chance.random() < 0.01:
                gateway.latch("x" * 300)


def main():
    """Print how much was sent, as JSON."""
    path, run, seed, datagrams, connections = sys.argv[1:]
    chance = random.Random(int(seed))
    sent = made = 0
    held = []
    while sent < int(datagrams) or made < int(connections):
        try:
            one = HostileSender(path, run, chance)
        except OSError:
            time.sleep(0.01)  # the queue of those that wait is full
            continue
        made += 1
        one.act(max(1, 2 * int(datagrams) // int(connections)))
        sent += one.datagrams
        held.append(one)
        if len(held) > HELD:
            held.pop(chance.randrange(len(held))).close()
    print(json.dumps({"datagrams": sent, "connections": made}))


if __name__ == "__main__":
    main()
