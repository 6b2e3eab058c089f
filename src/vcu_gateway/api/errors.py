"""Rights that the methods need, and the errors that they answer with."""

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


class ErrorCode(Enum):
    """Error codes: JSON-RPC's own, and ours from -32001 down; the word is the lower-case name."""

    PARSE_ERROR = -32700
    INVALID_REQUEST = -32600
    METHOD_NOT_FOUND = -32601
    INVALID_PARAMS = -32602
    INTERNAL_ERROR = -32603
    NO_RIGHT = -32001
    REFUSED = -32002
    """Not now, or not this: `data.refusal` says which, the sentence why."""
    TOO_MANY_CLIENTS = -32003
    NOT_READY = -32004
    """The gateway is starting or ending; try again."""
    CONFIG_REFUSED = -32005
    """The new configuration is not taken; `data.problems` has a line for each reason."""


class RequestError(Exception):
    """Failed request, answered with an error.

    Attributes:
        refusal: machine word of a REFUSED, as core.demand.Refusal has them.
        problems: one sentence for each thing wrong, for CONFIG_REFUSED.
    """

    def __init__(
        self, code: ErrorCode, sentence: str, refusal: str = "", problems: tuple[str, ...] = ()
    ) -> None:
        super().__init__(sentence)
        self.code = code
        self.sentence = sentence
        self.refusal = refusal
        self.problems = problems

    def as_json(self) -> dict[str, object]:
        """The `error` member of the response."""
        data: dict[str, object] = {"word": self.code.name.lower()}
        if self.refusal:
            data["refusal"] = self.refusal
        if self.problems:
            data["problems"] = list(self.problems)
        return {"code": self.code.value, "message": self.sentence, "data": data}
