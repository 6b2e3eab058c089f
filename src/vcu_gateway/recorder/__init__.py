"""Recorder: a process beside the gateway that keeps every drive on disk.

`receiver` takes the tap's datagrams from the gateways that connected, and never waits for the disk:
what it took lies in its `Backlog`, bounded, until the `writer`'s thread has it. A connection's
drive is a `DriveRecorder`, which writes segments in the format of `recording`; `ring` removes the
oldest of them, `incidents` keeps what surrounds a fault by hard links, and `program` says how it
goes. It imports the standard library alone, and nothing of the gateway.
"""

from pathlib import Path
from typing import NamedTuple

DEFAULT_SOCKET = Path("/run/vcu-gateway-recorder/tap.sock")


class RecorderOptions(NamedTuple):
    """What is kept, where, and how much of it.

    Attributes:
        max_bytes: of all drives; the oldest segments are removed above it.
        keep_free_bytes: of the file system; the oldest segments are removed below it.
        incident_max_bytes: of all incidents.
        memory_bytes: of what waits for the disk.
        before_s, after_s: what an incident keeps around its reason.
        gateway_user: who may hand over, besides root and the recorder's own user; None:
            vcu-gateway, where that user exists.
        status_path: file that says once a second how it goes; None: there is none.
        sign_key: private key of OpenSSH, without a passphrase, that signs; None: nothing is signed.
    """

    folder: Path
    socket_path: Path
    max_bytes: int
    keep_free_bytes: int
    incident_max_bytes: int
    memory_bytes: int
    before_s: float
    after_s: float
    status_path: Path | None
    sign_key: Path | None
    gateway_user: str | None


_UNITS = {"": 1, "k": 1 << 10, "m": 1 << 20, "g": 1 << 30, "t": 1 << 40}


def size_bytes(text: str) -> int:
    """Bytes of `4G`, `512M`, `100k` or `123456`; ValueError for anything else."""
    digits = text.strip().removesuffix("B").removesuffix("i")
    number, unit = (digits[:-1], digits[-1:]) if digits[-1:].isalpha() else (digits, "")
    if not (number.isascii() and number.isdecimal() and unit.lower() in _UNITS):
        raise ValueError(f"{text!r} is no size such as 4G, 512M or 100k")
    return int(number) * _UNITS[unit.lower()]
