"""Rights of a peer, from its user and groups."""

from enum import Enum
from typing import NamedTuple


class Right(Enum):
    """Right that a method needs; every peer that can open the socket has READ, and may stop."""

    READ = "read"
    OPERATE = "operate"
    SERVICE = "service"


class Peer(NamedTuple):
    """Process at the other end, as the kernel reports it (SO_PEERCRED, SO_PEERGROUPS).

    Attributes:
        groups: the primary group and every supplementary one.
    """

    pid: int
    uid: int
    groups: frozenset[int]


class Policy(NamedTuple):
    """Users and groups, by number, that have more rights than READ.

    `own_uid` is the gateway's own user; it and root may do everything.
    """

    own_uid: int
    operator_uids: frozenset[int] = frozenset()
    operator_gids: frozenset[int] = frozenset()
    service_uids: frozenset[int] = frozenset()
    service_gids: frozenset[int] = frozenset()

    def rights_of(self, peer: Peer) -> frozenset[Right]:
        """All rights of this peer."""
        if peer.uid in (0, self.own_uid):
            return frozenset(Right)
        rights = {Right.READ}
        if peer.uid in self.operator_uids or peer.groups & self.operator_gids:
            rights.add(Right.OPERATE)
        if peer.uid in self.service_uids or peer.groups & self.service_gids:
            rights.add(Right.SERVICE)
        return frozenset(rights)
