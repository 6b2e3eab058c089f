"""Connecting to the gateway's Unix socket: default path, timeout, remedies."""

import errno
import os
import socket
import struct
from pathlib import Path

from vcu_gateway.client.errors import UnreachableError

SOCKET_VARIABLE = "VCU_GATEWAY_SOCKET"
SOCKET_PATH = Path("/run/vcu-gateway/control.sock")

_REMEDIES = {
    errno.ENOENT: "there is no socket {path}: start the gateway (systemctl start vcu-gateway), or"
    f" name its socket in {SOCKET_VARIABLE}",
    errno.ECONNREFUSED: "no process listens at {path}: the gateway has ended; start it"
    " (systemctl start vcu-gateway)",
    errno.EACCES: "no permission to open {path}: join the group that `ls -l {path}` shows, and"
    " log in again",
    errno.EAGAIN: "{path} takes no more connections: the gateway hangs or is overrun; see"
    " `systemctl status vcu-gateway`",
}


def default_socket_path() -> Path:
    """Path of the gateway's socket: VCU_GATEWAY_SOCKET, else /run/vcu-gateway/control.sock."""
    return Path(os.environ.get(SOCKET_VARIABLE) or SOCKET_PATH)


def connect(path: Path, timeout_s: float = 0.0) -> socket.socket:
    """A connected, non-blocking socket.

    Args:
        path: the Unix socket.
        timeout_s: longest wait while the listener's backlog is full; 0 does not wait.

    Raises:
        UnreachableError: the message says what to do.
    """
    try:
        return _connected_socket(os.fspath(path), timeout_s)
    except OSError as error:
        known = _REMEDIES.get(error.errno or 0)
        sentence = known.format(path=path) if known else f"cannot connect to {path}: {error}"
        raise UnreachableError(sentence) from error


def _connected_socket(path: str, timeout_s: float) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        if timeout_s > 0:
            # Not socket.settimeout: a non-blocking connect fails at once on a full backlog.
            timeval = struct.pack("@ll", int(timeout_s), int(timeout_s % 1 * 1e6))
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, timeval)
            connection.connect(path)
        connection.setblocking(False)
        if timeout_s <= 0:
            connection.connect(path)
    except BaseException:
        connection.close()
        raise
    return connection
