"""The listening sockets: a path that only the right people open, and a port of this machine."""

import errno
import grp
import os
import pwd
import socket
import stat
from pathlib import Path
from typing import NamedTuple

from vcu_gateway.api.rights import Policy
from vcu_gateway.errors import Problem, UnavailableError

_MAX_PATH_BYTES = 107
_BACKLOG = 64
_AS_MADE = -1, -1  # of an owner and a group: chown leaves both as they are
_REMEDIES = {
    errno.ENOENT: "create the folder {folder}; a service gets it from RuntimeDirectory=",
    errno.ENOTDIR: "{folder} must be a folder",
    errno.EACCES: "this user must be able to write into {folder}",
    errno.EPERM: "owner and group need CAP_CHOWN, or groups of this user; or leave them out",
    errno.EROFS: "choose a path that can be written, as below /run",
}


class ServerSettings(NamedTuple):
    """Where the API listens, and who may do what.

    Attributes:
        owner: of the socket, name or number; None leaves it as it is. group: the same.
        mode: permission bits of the socket.
        metrics_port: of 127.0.0.1, 0 for any, for `GET /metrics` alone; None for no port.
    """

    socket_path: Path
    policy: Policy
    owner: str | int | None = None
    group: str | int | None = None
    mode: int = 0o660
    metrics_port: int | None = None


class UnixListener:
    """The listening Unix socket, and its name in the file system."""

    def __init__(self, settings: ServerSettings) -> None:
        """Bind and listen; UnavailableError, with what to do, where that cannot be."""
        self._path = os.fspath(settings.socket_path)
        _check_path(self._path)
        _make_room(self._path)
        self._identity: tuple[int, int] | None = None
        self.sock = _socket(socket.AF_UNIX)
        try:
            self.sock.bind(self._path)
            self._identity = _identity(self._path)
            # The service's sandbox refuses even a chown that changes nothing.
            if (owners := _owners(settings)) != _AS_MADE:
                os.chown(self._path, *owners)
            os.chmod(self._path, settings.mode)
            self.sock.listen(_BACKLOG)  # last: nobody connects before the rights are set
        except OSError as error:
            self.close()
            raise UnavailableError(_explain(self._path, error)) from error
        except UnavailableError:
            self.close()
            raise

    def close(self) -> None:
        """Stop listening and remove the name, unless it is somebody else's by now."""
        self.sock.close()
        if self._identity is not None and self._identity == _identity(self._path):
            os.unlink(self._path)
        self._identity = None


def listen_on_loopback(port: int) -> socket.socket:
    """A TCP socket of this machine alone; UnavailableError where the port cannot be had."""
    sock = _socket(socket.AF_INET)
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        sock.bind(("127.0.0.1", port))
        sock.listen(_BACKLOG)
    except OSError as error:
        sock.close()
        what = f"cannot listen on 127.0.0.1 port {port}: {error.strerror}"
        remedy = f"choose another port, or look who has it: ss -ltnp 'sport = :{port}'"
        raise UnavailableError(Problem(what, remedy=remedy)) from error
    return sock


def _socket(family: socket.AddressFamily) -> socket.socket:
    sock = socket.socket(family, socket.SOCK_STREAM)
    sock.setblocking(False)
    return sock


def _check_path(path: str) -> None:
    length = len(os.fsencode(path))
    if length > _MAX_PATH_BYTES or "\0" in path:
        what = f"{path!r} cannot be a socket: {length} bytes, and {_MAX_PATH_BYTES} are possible"
        raise UnavailableError(Problem(what, remedy="choose a shorter path"))


def _identity(path: str) -> tuple[int, int] | None:
    """Device and inode of what has this name; None where nothing has."""
    try:
        found = os.lstat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _make_room(path: str) -> None:
    """Remove the socket that an earlier run left behind; leave everything else alone."""
    try:
        kind = os.lstat(path).st_mode
    except OSError:
        return  # binding tells what is wrong, if anything is
    if not stat.S_ISSOCK(kind):
        what = f"{path} exists and is no socket"
        raise UnavailableError(Problem(what, remedy="remove it, or choose another path"))
    try:
        with _socket(socket.AF_UNIX) as probe:
            probe.connect(path)
    except ConnectionRefusedError:
        _remove_stale(path)
        return
    except BlockingIOError:
        pass  # its backlog is full: it lives
    except OSError as error:
        raise UnavailableError(_explain(path, error)) from error
    remedy = f"stop it, or choose another path; look who it is: ss -lxp src {path}"
    raise UnavailableError(Problem(f"another process answers at {path}", remedy=remedy))


def _remove_stale(path: str) -> None:
    try:
        os.unlink(path)
    except OSError as error:
        what = f"{path} is left over, and cannot be removed: {error.strerror}"
        raise UnavailableError(Problem(what, remedy=f"rm {path}")) from error


def _owners(settings: ServerSettings) -> tuple[int, int]:
    """User and group number; -1 leaves it as it is."""
    owner, group = settings.owner, settings.group
    try:
        uid = pwd.getpwnam(owner).pw_uid if isinstance(owner, str) else owner
        gid = grp.getgrnam(group).gr_gid if isinstance(group, str) else group
    except KeyError as error:
        what = f"the socket's owner or group does not exist: {error.args[0]}"
        raise UnavailableError(Problem(what, remedy="create it, or name another one")) from error
    return -1 if uid is None else uid, -1 if gid is None else gid


def _explain(path: str, error: OSError) -> Problem:
    folder = os.path.dirname(path) or "."
    remedy = _REMEDIES.get(error.errno or 0, "look at: ls -ld {folder}").format(folder=folder)
    return Problem(f"cannot listen at {path}: {error.strerror}", remedy=remedy)
