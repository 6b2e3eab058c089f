"""The process at the other end of a Unix socket, as the kernel tells it."""

import socket
import struct

from vcu_gateway.api.rights import Peer

_UCRED = struct.Struct("iII")
_SO_PEERGROUPS = 59  # Linux 4.13; the socket module does not name it
_GROUPS_BYTES = 1024  # the most that getsockopt takes here: 256 groups


def peer_of(sock: socket.socket) -> Peer:
    """Who connected, as it was at that moment; a later change of user does not count."""
    credentials = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _UCRED.size)
    pid, uid, gid = _UCRED.unpack(credentials)
    return Peer(pid, uid, frozenset({gid, *_further_groups(sock)}))


def _further_groups(sock: socket.socket) -> tuple[int, ...]:
    """Supplementary groups; none where the kernel cannot tell, so that nobody gains a right."""
    try:
        data = sock.getsockopt(socket.SOL_SOCKET, _SO_PEERGROUPS, _GROUPS_BYTES)
    except OSError:
        return ()
    return struct.unpack(f"{len(data) // 4}I", data)
