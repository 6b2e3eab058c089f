"""Floods of the gateway's API: `python -m tests.server.attack KIND SOCKET`, until stdin ends."""

import contextlib
import itertools
import json
import os
import socket
import sys
import threading
from dataclasses import dataclass
from typing import Any


def line(method: str, number: int = 1, **params: Any) -> bytes:
    message = {"jsonrpc": "2.0", "id": number, "method": method, "params": params}
    return json.dumps(message).encode() + b"\n"


@dataclass(frozen=True)
class Kind:
    """How many clients send what at once, and whether they leave after an answer."""

    clients: int
    text: bytes
    leaves: bool = True


KINDS = {
    "": Kind(0, b""),
    "reconnecting": Kind(200, line("why")),
    "connecting": Kind(200, b""),
    "piling": Kind(200, line("state.get") * 50),
    "stopping": Kind(64, line("disarm")),
    "naming-stops": Kind(14, line("why", x="estop") * 1000, leaves=False),
    "asking": Kind(14, line("state.get"), leaves=False),
}


def attack(kind: Kind, path: str, answered: list[int], end: threading.Event) -> None:
    while not end.is_set():
        with contextlib.suppress(OSError), socket.socket(socket.AF_UNIX) as one:
            one.connect(path)  # waits for its turn in the backlog, which it does not with a timeout
            one.settimeout(10)
            is_open = True
            while is_open and not end.is_set():
                one.sendall(kind.text)
                is_open = not kind.text or bool(one.recv(65536))
                answered[0] += 1
                is_open = is_open and not kind.leaves


def main(name: str, path: str) -> None:
    os.nice(10)  # its own cost is not what is measured
    kind, answered, end = KINDS[name], [0], threading.Event()
    threads = [
        threading.Thread(target=attack, args=(kind, path, answered, end), daemon=True)
        for _ in range(kind.clients)
    ]
    for thread in threads:
        thread.start()
    print("attacking", flush=True)
    sys.stdin.read()
    end.set()
    print(answered[0], flush=True)


if __name__ == "__main__":
    main(*itertools.islice(sys.argv, 1, None))
