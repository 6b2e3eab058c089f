"""Floods of the page's server: `python -m tests.web.attack KIND PORT [COOKIE]`, until stdin ends.

Each client asks again as soon as it was answered, and connects again where it was cut off. The
number of answers is told at the end.
"""

import asyncio
import contextlib
import itertools
import json
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

HISTORY = "/api/history?points=4000&signals=" + ",".join(
    f"PCU{number}_Status2.{name}"
    for number in (1, 2)
    for name in ("BatteryVoltage", "BatteryCurrent", "PhaseCurrent", "MotorSpeed")
)


@dataclass(frozen=True)
class Kind:
    """How many clients, from how many addresses, send what; 0 is the address of who stops."""

    clients: int
    addresses: int
    request: Callable[["Attack"], bytes]


@dataclass
class Attack:
    """One run, and what it has been answered."""

    port: int
    cookie: str
    password: str
    answered: int = 0

    def head(self, method: str, path: str, body: bytes = b"") -> bytes:
        host = f"127.0.0.1:{self.port}"
        lines = [f"{method} {path} HTTP/1.1", f"Host: {host}", f"Cookie: {self.cookie}"]
        if method == "POST":
            lines += [f"Origin: http://{host}", f"Content-Length: {len(body)}"]
        return "\r\n".join(lines).encode() + b"\r\n\r\n" + body

    async def client(self, kind: Kind, number: int) -> None:
        address = f"127.0.0.{2 + number % kind.addresses if kind.addresses else 1}"
        while True:
            with contextlib.suppress(OSError, asyncio.IncompleteReadError, ValueError):
                await self._talk(kind.request(self), address)
            await asyncio.sleep(0.001)

    async def _talk(self, request: bytes, address: str) -> None:
        reader, writer = await asyncio.open_connection(
            "127.0.0.1", self.port, local_addr=(address, 0)
        )
        try:
            while request:
                writer.write(request)
                head = await reader.readuntil(b"\r\n\r\n")
                length = head.lower().partition(b"content-length:")[2].split(b"\r\n")[0]
                await reader.readexactly(int(length))
                self.answered += 1
            await reader.read()
        finally:
            writer.close()


def asks(path: str) -> Callable[[Attack], bytes]:
    return lambda attack: attack.head("GET", path)


def acts(name: str) -> Callable[[Attack], bytes]:
    return lambda attack: attack.head("POST", f"/api/actions/{name}")


def stops_unsigned(attack: Attack) -> bytes:
    return replace(attack, cookie="none=1").head("POST", "/api/actions/estop")


def signs_in(attack: Attack) -> bytes:
    given = json.dumps({"name": "anna", "password": attack.password}).encode()
    return attack.head("POST", "/api/session", given)


KINDS = {
    "": Kind(0, 1, lambda _: b""),
    "history": Kind(100, 1, asks(HISTORY)),
    "histories": Kind(100, 4, asks(HISTORY)),
    "history-of-the-same-address": Kind(100, 0, asks(HISTORY)),
    "held": Kind(256, 2, lambda _: b""),
    "files": Kind(100, 2, asks("/")),
    "sign-in": Kind(4, 4, signs_in),
    "disarm": Kind(64, 1, acts("disarm")),
    "estop-unsigned": Kind(64, 1, stops_unsigned),
}


async def attacked(kind: Kind, attack: Attack) -> None:
    clients = [asyncio.create_task(attack.client(kind, one)) for one in range(kind.clients)]
    await asyncio.sleep(1.0)
    print("attacking", flush=True)
    await asyncio.to_thread(sys.stdin.read)
    for client in clients:
        client.cancel()
    print(attack.answered, flush=True)


def main(name: str, port: str, cookie: str = "", password: str = "") -> None:
    os.nice(10)  # it is another machine that attacks
    asyncio.run(attacked(KINDS[name], Attack(int(port), cookie, password)))


if __name__ == "__main__":
    main(*itertools.islice(sys.argv, 1, None))
