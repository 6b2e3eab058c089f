"""What systemd is told, over the socket that it gives to a service of Type=notify."""

import contextlib
import os
import socket
from collections.abc import Mapping

from vcu_gateway.units import NS_PER_US

_STATUS_CHARACTERS = 500


class SystemdNotifier:
    """The service manager that started this process; everything is silent where there is none.

    Telling never waits and never raises: nothing that ticks may depend on who listens.

    Attributes:
        watchdog_ns: it kills this process after so long without a ping; None: it does not.
    """

    def __init__(self, environment: Mapping[str, str], own_pid: int) -> None:
        address = environment.get("NOTIFY_SOCKET", "")
        self._socket = _connected("\0" + address[1:] if address[:1] == "@" else address)
        self.watchdog_ns = _watchdog_ns(environment, own_pid)

    @classmethod
    def of_this_process(cls) -> "SystemdNotifier":
        """As the environment says."""
        return cls(os.environ, os.getpid())

    def ready(self) -> None:
        """The service has started."""
        self._tell("READY=1")

    def alive(self) -> None:
        """The watchdog's ping."""
        self._tell("WATCHDOG=1")

    def stopping(self) -> None:
        """The service is about to end."""
        self._tell("STOPPING=1")

    def status(self, sentence: str) -> None:
        """What `systemctl status` shows, in one line."""
        self._tell("STATUS=" + " ".join(sentence.split())[:_STATUS_CHARACTERS])

    def _tell(self, line: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):  # nobody there, or too busy: told again later
                self._socket.send(line.encode(), socket.MSG_DONTWAIT)


def _connected(address: str) -> socket.socket | None:
    if not address:
        return None
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
    try:
        manager.connect(address)
    except (OSError, ValueError):
        manager.close()
        return None
    return manager


def _watchdog_ns(environment: Mapping[str, str], own_pid: int) -> int | None:
    """The limit, where it is set for this very process."""
    if environment.get("WATCHDOG_PID", str(own_pid)) != str(own_pid):
        return None
    text = environment.get("WATCHDOG_USEC", "")
    return int(text) * NS_PER_US if text.isascii() and text.isdecimal() and int(text) else None
