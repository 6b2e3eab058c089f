"""HELLO: what a gateway says of itself when it begins to be recorded; drive.json, later."""

import os
import platform
from typing import Any, NamedTuple

from vcu_gateway import __version__
from vcu_gateway.core.schedule import ClockPair
from vcu_gateway.core.settings import Settings
from vcu_gateway.drive.settings_json import settings_json
from vcu_gateway.drive_format import datagram


class Hello(NamedTuple):
    """Everything that reading and replaying a drive needs besides its inputs.

    Attributes:
        run: id of the gateway's process, another one for each.
        boot: id of the machine's boot; empty where it is not known.
        clock: both clocks, read together once for the whole run.
        config: effective configuration as YAML; config_digest: that of `check-config`.
        dbc: text of the DBC; dbc_digest: the begin of its SHA-256.
    """

    run: str
    boot: str
    channel: str
    clock: ClockPair
    settings: Settings
    config: str
    config_digest: str
    dbc: str
    dbc_digest: str

    def values(self) -> dict[str, Any]:
        return self._asdict() | {
            "format": datagram.FORMAT,
            "versions": versions(),
            "clock": {
                "monotonic_ns": self.clock.monotonic_ns,
                "wall_ns": self.clock.wall_ns,
            },
            "settings": settings_json(self.settings),
        }


def versions() -> dict[str, str]:
    """Versions of this program, of Python and of the kernel, and the processor's name."""
    system = os.uname()
    return {
        "gateway": __version__,
        "python": platform.python_version(),
        "kernel": system.release,
        "machine": system.machine,
    }
