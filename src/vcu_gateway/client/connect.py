"""Where the gateway listens, and the way in."""

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
    errno.ECONNREFUSED: "nobody listens at {path}: the gateway has ended; start it"
    " (systemctl start vcu-gateway)",
    errno.EACCES: "no permission to open {path}: join the group that `ls -l {path}` shows, and"
    " log in again",
    errno.EAGAIN: "{path} takes no more connections: the gateway hangs or is overrun; see"
    " `systemctl status vcu-gateway`",
}


def default_socket_path() -> Path:
    """VCU_GATEWAY_SOCKET where it is set, else /run/vcu-gateway/control.sock."""
    return Path(os.environ.get(SOCKET_VARIABLE) or SOCKET_PATH)


def connect(path: Path, within_s: float = 0.0) -> socket.socket:
    """A non-blocking connection; UnreachableError says what to do.

    Where others crowd in, it waits for its turn for so long: the kernel lets them in one by one.
    """
    try:
        return _connected(os.fspath(path), within_s)
    except OSError as error:
        known = _REMEDIES.get(error.errno or 0)
        sentence = known.format(path=path) if known else f"cannot connect to {path}: {error}"
        raise UnreachableError(sentence) from error


def _connected(path: str, within_s: float) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        if within_s > 0:
            # Not Python's own time-out: with that it would not wait here at all.
            timeval = struct.pack("@ll", int(within_s), int(within_s % 1 * 1e6))
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, timeval)
            connection.connect(path)
        connection.setblocking(False)
        if within_s <= 0:
            connection.connect(path)
    except BaseException:
        connection.close()
        raise
    return connection
