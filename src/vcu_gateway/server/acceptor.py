"""The API's sockets: made with their rights, and the connections that they accept."""

import contextlib
import errno
import itertools
import os
import socket
import stat
import struct
from collections.abc import Callable

from vcu_gateway.api.errors import ErrorCode, Peer, RequestError, Right
from vcu_gateway.errors import Problem, UnavailableError
from vcu_gateway.server import jsonrpc
from vcu_gateway.server.service import Caller, Counters, ServerSettings
from vcu_gateway.server.session import Session

_MAX_PATH_BYTES = 107
_BACKLOG = 256
_UNCHANGED = -1  # chown leaves this owner or group as it is
_REMEDIES = {
    errno.ENOENT: "create the folder {folder}; a service gets it from RuntimeDirectory=",
    errno.ENOTDIR: "{folder} must be a folder",
    errno.EACCES: "this user must be able to write into {folder}",
    errno.EPERM: "owner and group need CAP_CHOWN, or groups of this user; or leave them out",
    errno.EROFS: "choose a path that can be written, as below /run",
}


class UnixListener:
    """Listening Unix socket that owns its name in the file system."""

    def __init__(self, settings: ServerSettings) -> None:
        """Bind and listen; UnavailableError, with what to do, where that cannot be."""
        self._path = os.fspath(settings.socket_path)
        _check_path(self._path)
        if problem := obstacle(self._path):
            raise UnavailableError(problem)
        _remove_leftover(self._path)
        self._identity: tuple[int, int] | None = None
        self.sock = _socket()
        try:
            self.sock.bind(self._path)
            self._identity = _identity(self._path)
            _set_owner(self._path, settings.owner, settings.group)
            os.chmod(self._path, settings.mode)
            self.sock.listen(_BACKLOG)  # last: nobody connects before the rights are set
        except OSError as error:
            self.close()
            raise UnavailableError(_explain(self._path, error)) from error

    def close(self) -> None:
        """Stop listening and remove the name, unless it is somebody else's by now."""
        self.sock.close()
        if self._identity is not None and self._identity == _identity(self._path):
            os.unlink(self._path)
        self._identity = None


def _socket() -> socket.socket:
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    sock.setblocking(False)
    return sock


def _check_path(path: str) -> None:
    length = len(os.fsencode(path))
    if length > _MAX_PATH_BYTES or "\0" in path:
        what = f"{path!r} cannot be a socket: {length} bytes, and {_MAX_PATH_BYTES} are possible"
        raise UnavailableError(Problem(what, remedy="choose a shorter path"))


def _identity(path: str) -> tuple[int, int] | None:
    """Device and inode at this path; None where there is nothing."""
    try:
        found = os.lstat(path)
    except OSError:
        return None
    return found.st_dev, found.st_ino


def obstacle(path: str) -> Problem | None:
    """Problem of a path that cannot become a socket now; None where nobody can see one."""
    try:
        kind = os.lstat(path).st_mode
    except OSError as error:
        nothing_there = isinstance(error, FileNotFoundError) and os.path.isdir(_folder_of(path))
        return None if nothing_there else _explain(path, error)
    if stat.S_ISSOCK(kind):
        return None
    what = f"{path} exists and is no socket"
    return Problem(what, remedy="remove it, or choose another path")


def _remove_leftover(path: str) -> None:
    if not os.path.lexists(path):
        return
    try:
        with _socket() as probe:
            probe.connect(path)
    except ConnectionRefusedError:
        _remove_stale(path)
        return
    except BlockingIOError:
        pass  # its backlog is full: the process lives
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


def _set_owner(path: str, owner: int | None, group: int | None) -> None:
    # The service's sandbox refuses even a chown that changes nothing.
    if owner is not None or group is not None:
        uid = _UNCHANGED if owner is None else owner
        gid = _UNCHANGED if group is None else group
        os.chown(path, uid, gid)


def _folder_of(path: str) -> str:
    return os.path.dirname(path) or "."


def _explain(path: str, error: OSError) -> Problem:
    remedy = _REMEDIES.get(error.errno or 0, "look at: ls -ld {folder}")
    remedy = remedy.format(folder=_folder_of(path))
    return Problem(f"cannot listen at {path}: {error.strerror}", remedy=remedy)


_UCRED = struct.Struct("iII")
_SO_PEERGROUPS = 59  # Linux 4.13; the socket module does not name it
_GROUPS_BYTES = 1024  # the most that getsockopt takes here: 256 groups


def peer_of(sock: socket.socket) -> Peer:
    """Process, user and groups of the peer when it connected; a later change does not count."""
    credentials = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size)
    pid, uid, gid = _UCRED.unpack(credentials)
    return Peer(pid, uid, frozenset({gid, *_further_groups(sock)}))


def _further_groups(sock: socket.socket) -> tuple[int, ...]:
    """Supplementary groups; none where the kernel cannot say, so that no right is gained."""
    try:
        data = sock.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _GROUPS_BYTES)
    except OSError:
        return ()
    return struct.unpack(f"{len(data) // 4}I", data)


_OUT_OF_RESOURCES = (errno.EMFILE, errno.ENFILE, errno.ENOBUFS, errno.ENOMEM)
_ABORTED = (errno.ECONNABORTED, errno.EPROTO, errno.EINTR)


EvictOne = Callable[[Caller, bool], bool]
"""Closes a connection to make room for this caller; True where one was closed.

The second argument is True where it has to be one that may only read.
"""


class Acceptor:
    """Accepts the connections of one listening socket.

    Attributes:
        ready_ns: time from which it accepts; until then connections wait in the backlog.
    """

    _numbers = itertools.count(1)

    def __init__(self, sock: socket.socket, settings: ServerSettings, counters: Counters) -> None:
        self.sock = sock
        self._policy = settings.policy
        self._limits = settings.limits
        self._counters = counters
        self.ready_ns = 0

    def next_socket(self, now_ns: int) -> socket.socket | None:
        """Socket of the next connection; None where none waits, or none can be had now."""
        try:
            sock, _ = self.sock.accept()
        except BlockingIOError:
            return None
        except OSError as error:
            if error.errno in _OUT_OF_RESOURCES:
                self.ready_ns = now_ns + self._limits.accept_pause_ns
                return None
            if error.errno in _ABORTED:
                return None
            raise
        sock.setblocking(False)
        return sock

    def session(self, sock: socket.socket, now_ns: int) -> Session:
        peer = peer_of(sock)
        caller = Caller(next(self._numbers), peer, self._policy.rights_of(peer))
        return Session(sock, caller, self._limits, now_ns)

    def has_place(self, caller: Caller, clients: int, readers: int, evict_one: EvictOne) -> bool:
        """True where a place is free, or was made; `readers` of the clients may only read."""
        limits = self._limits
        if may_only_read(caller) and readers >= limits.clients - limits.reserved_clients:
            return evict_one(caller, True)
        return clients < limits.clients or evict_one(caller, False)

    def turn_away(self, sock: socket.socket) -> None:
        self._counters.turned_away += 1
        what = (
            f"no place is left: {self._limits.clients} clients at most,"
            f" {self._limits.reserved_clients} places kept for those who may operate,"
            " and a demand keeps its place"
        )
        line = jsonrpc.error_line(None, RequestError(ErrorCode.TOO_MANY_CLIENTS, what))
        with contextlib.suppress(OSError):  # the peer may have closed it
            sock.send(line, socket.MSG_NOSIGNAL)


def has_left(sock: socket.socket) -> bool:
    """True where the peer has ended and asked for nothing: the cheapest of a flood."""
    try:
        return not sock.recv(1, socket.MSG_PEEK)
    except BlockingIOError:
        return False
    except OSError:
        return True


def may_only_read(caller: Caller) -> bool:
    """True where none of the reserved places is for this peer."""
    return caller.rights == {Right.READ}
