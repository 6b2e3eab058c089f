"""Listening SEQPACKET socket: systemd's (LISTEN_FDS), or one of our own."""

import contextlib
import os
import socket
import stat
from collections.abc import Mapping
from pathlib import Path

from vcu_gateway.errors import Problem, UnavailableError

_FIRST_PASSED = 3
_BACKLOG = 16
_MODE = 0o660


class TapListener:
    """Socket that gateways connect to; its name goes with it where it is our own."""

    def __init__(self, path: Path, environment: Mapping[str, str], own_pid: int) -> None:
        """Take the socket that was handed over, else make one; UnavailableError if neither can."""
        self._own_path: Path | None = None
        if environment.get("LISTEN_PID") == str(own_pid) and environment.get("LISTEN_FDS"):
            self.sock = socket.socket(fileno=_FIRST_PASSED)
            self.name = "the socket of the service manager"
        else:
            self.sock = _bound(path)
            self._own_path = path
            self.name = str(path)
        self.sock.setblocking(False)

    def close(self) -> None:
        self.sock.close()
        if self._own_path is not None:
            with contextlib.suppress(OSError):
                self._own_path.unlink()


def _bound(path: Path) -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        _remove_leftover(path)
        sock.bind(os.fspath(path))
        path.chmod(_MODE)
        sock.listen(_BACKLOG)
    except OSError as error:
        sock.close()
        what = f"cannot listen at {path}: {error.strerror or error}"
        remedy = f"its folder must be there and be this user's; look at: ls -ld {path.parent}"
        raise UnavailableError(Problem(what, remedy=remedy)) from error
    return sock


def _remove_leftover(path: Path) -> None:
    if not os.path.lexists(path):
        return
    if not stat.S_ISSOCK(path.lstat().st_mode):
        what = f"{path} exists and is no socket"
        raise UnavailableError(Problem(what, remedy="remove it, or choose another path"))
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as probe:
        try:
            probe.connect(os.fspath(path))
        except ConnectionRefusedError:
            path.unlink()
            return
    remedy = "stop it, or choose another path with --socket"
    raise UnavailableError(Problem(f"another recorder answers at {path}", remedy=remedy))
