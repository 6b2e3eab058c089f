"""Settings of the server: address, rights of the peers, and limits on what they may cost."""

from pathlib import Path
from typing import NamedTuple

from vcu_gateway.api.rights import Policy
from vcu_gateway.units import NS_PER_S


class ServerSettings(NamedTuple):
    """Address of the API, and the rights of its peers.

    Attributes:
        owner: user number of the socket; None leaves it as it is. group: the same, of its group.
        mode: permission bits of the socket.
    """

    socket_path: Path
    policy: Policy
    owner: int | None = None
    group: int | None = None
    mode: int = 0o660


class SessionLimits(NamedTuple):
    """Limits on the cost of the clients.

    Attributes:
        reserved_clients: of `clients`, for peers that may do more than read.
        rate_per_s: requests of one connection; `burst` of them at once.
        pending_requests: requests of one connection that wait for their reply.
        output_bytes: replies that one connection has not read.
        timeout_ns: for the end of a line, and for a reader to go on reading.
        accept_pause_ns: without accepting, after the system had no descriptor or memory left.
        linger_ns: for pending replies at the end of the server.
    """

    clients: int = 16
    reserved_clients: int = 4
    rate_per_s: int = 200
    burst: int = 50
    pending_requests: int = 16
    output_bytes: int = 262_144
    timeout_ns: int = 10 * NS_PER_S
    accept_pause_ns: int = NS_PER_S
    linger_ns: int = 300_000_000


DEFAULT_LIMITS = SessionLimits()
